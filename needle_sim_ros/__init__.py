# SPDX-License-Identifier: Apache-2.0
"""Flexible needle in soft tissue: a plant for needle-steering robots, over ROS 2."""
