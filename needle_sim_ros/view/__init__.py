# SPDX-License-Identifier: Apache-2.0
"""Pictures of a run: forces, marker tracks, the deformed section, tick times.

Each module draws one panel into given axes; :mod:`needle_sim_ros.view.figure` puts them
together. matplotlib is imported here and below, so callers import these modules late.
"""
