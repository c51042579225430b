# SPDX-License-Identifier: Apache-2.0
"""The needle: a massless cantilever with a bevelled tip."""
