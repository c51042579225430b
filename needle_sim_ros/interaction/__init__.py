# SPDX-License-Identifier: Apache-2.0
"""Laws between needle and tissue."""
