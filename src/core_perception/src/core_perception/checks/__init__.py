# SPDX-License-Identifier: BSD-3-Clause
"""The parts of the start-up self-check, each a pure function of a few frames."""
