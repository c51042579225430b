# SPDX-License-Identifier: Apache-2.0
"""A tick: the way of the base, its division, and needle and tissue together."""
