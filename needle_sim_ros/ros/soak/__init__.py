# SPDX-License-Identifier: Apache-2.0
"""Drives the real node by real topics from other processes, kindly and not."""
