# SPDX-License-Identifier: Apache-2.0
"""Parameters of tissue and needle from recorded experiments."""
