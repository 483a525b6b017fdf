# SPDX-License-Identifier: BSD-3-Clause
"""Colours that models share, red, green and blue in 0..255."""

BLACK, RUBBER, DARK = (30, 30, 32), (44, 44, 48), (66, 70, 74)
STEEL, WHITE = (186, 190, 196), (244, 244, 241)
YELLOW, ORANGE, RED, BLUE = (250, 208, 20), (240, 128, 16), (206, 28, 28), (28, 88, 172)
