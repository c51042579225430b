# SPDX-License-Identifier: Apache-2.0
"""Planning: quick rollouts, hitting a target that moves with the tissue."""
