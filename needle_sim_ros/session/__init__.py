# SPDX-License-Identifier: Apache-2.0
"""Recorded sessions: rosbag2 folders of MCAP files, written and read without rclpy."""
