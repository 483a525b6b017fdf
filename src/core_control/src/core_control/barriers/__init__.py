# SPDX-License-Identifier: BSD-3-Clause
"""Barriers: each turns a safety field and a pose into rows a . u >= b."""
