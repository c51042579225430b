# SPDX-License-Identifier: Apache-2.0
"""Accuracy, speed, scaling and stability, with the paper's own algorithm as baseline."""
