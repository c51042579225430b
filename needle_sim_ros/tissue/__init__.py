# SPDX-License-Identifier: Apache-2.0
"""The tissue: mesh, elements, compliance, dynamics."""
