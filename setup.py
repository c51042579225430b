# SPDX-License-Identifier: Apache-2.0
"""All package metadata: ament_python and Ubuntu 24.04's colcon read it from here."""

from pathlib import Path

from setuptools import Extension, find_packages, setup

NAME = "needle_sim_ros"


def share(*folders: str) -> list[tuple[str, list[str]]]:
    """List every file under `folders`, keeping the tree, for ``share/needle_sim_ros``."""
    files: dict[str, list[str]] = {}
    for folder in folders:
        for path in sorted(Path(folder).rglob("*")):
            if path.is_file():
                files.setdefault(f"share/{NAME}/{path.parent.as_posix()}", []).append(
                    path.as_posix()
                )
    return sorted(files.items())


def compiled(place: str) -> Extension:
    """Describe a module in C at a place in the package."""
    return Extension(
        f"{NAME}.{place.replace('/', '.')}",
        [f"{NAME}/{place}.c"],
        depends=[str(header) for header in Path(NAME).rglob("*.h")],
        extra_compile_args=["-O3", "-std=c11", "-Wall", "-Wextra", "-ffp-contract=off"],
        optional=True,
    )


setup(
    name=NAME,
    version="0.1.0",
    description="A flexible needle entering soft tissue, simulated behind a ROS 2 node",
    license="Apache-2.0",
    maintainer="needle_sim_ros maintainers",
    maintainer_email="maintainers@example.org",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    python_requires=">=3.10",
    # The hot parts of a tick; where there is no compiler, numpy does the same.
    ext_modules=[
        compiled("interaction/_balance"),
        compiled("interaction/_readings"),
        compiled("ros/_wait"),
        compiled("session/_messages"),
        compiled("tissue/_grid"),
        compiled("tissue/_modal"),
        compiled("tissue/_products"),
    ],
    install_requires=[
        "numpy>=1.26",
        "scipy>=1.11",
        "scikit-fem>=12.0",
        # Tissue from a mesh file, in whatever format; its own reader would be a project.
        "meshio>=5.3",
        "PyYAML>=6.0",
        "tqdm>=4.66",
        "matplotlib>=3.6",
        # Films as GIF; matplotlib brings it anyway.
        "Pillow>=9.0",
        # Ranges, not pins: rosdep brings the newest into a workspace that others share.
        "mcap>=1.6,<2",
        "mcap-ros2-support>=0.6,<1",
    ],
    extras_require={
        # ROS 2 Jazzy as wheels (x86_64 Linux), the environment this package is tested in.
        # Unpinned, these resolve to a newer distribution. Leave it out where ROS 2 is from apt.
        "ros": [
            "ros-jazzy-rclpy==7.1.6",
            "ros-jazzy-rmw-fastrtps-cpp==8.4.3",
            "ros-jazzy-common-interfaces==5.3.6",
            "mcap==1.6.0",
            "mcap-ros2-support==0.6.0",
        ],
        "test": [
            "pytest>=7.4",
            "pytest-timeout>=2.2",
            "pytest-xdist>=3.5",
            "hypothesis>=6.98",
            "rosbags==0.11.9",
        ],
        "lint": [
            "ruff==0.17.6",
            "mypy==2.4.1",
            "types-PyYAML==6.0.12.20261113",
            'scipy-stubs==1.17.1.5; python_version >= "3.11"',
        ],
        # Faster sparse Cholesky for large meshes: Intel's MKL, 200 MB, x86_64 only.
        "fast": ["pypardiso>=0.4.6"],
        # `--dask ADDRESS`: work on a cluster through distributed's executor.
        "dask": ["distributed>=2023.1"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        *share("config", "bags", "launch"),
    ],
    entry_points={
        "console_scripts": [
            "needle_sim = needle_sim_ros.cli:main",
            "sim_node = needle_sim_ros.ros.node:main",
            "managed_sim_node = needle_sim_ros.ros.node:main_managed",
        ],
    },
    zip_safe=False,
)
