# SPDX-License-Identifier: Apache-2.0
"""How slowly the tissue can swing, as far as a time step has to know."""

from __future__ import annotations

import math

from needle_sim_ros.scene import Region, Tissue
from needle_sim_ros.tissue.material import lame_parameters


def slowest_period(tissue: Tissue) -> float:
    """Return the period of a shear wave that stands in the depth of the softest tissue, s.

    With one end held and the other free, a quarter of its length is the depth.
    """
    speeds = []
    parts: list[Tissue | Region] = [tissue, *tissue.regions]
    for part in parts:
        modulus = part.youngs_modulus or tissue.youngs_modulus
        ratio = part.poisson_ratio
        ratio = tissue.poisson_ratio if ratio is None else ratio
        _, shear = lame_parameters(modulus, ratio, None)
        speeds.append(math.sqrt(shear / (part.density or tissue.density)))
    return 4.0 * tissue.size[-1] / min(speeds)
