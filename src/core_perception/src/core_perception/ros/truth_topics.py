# SPDX-License-Identifier: BSD-3-Clause
"""Where the simulator tells the truth; the segmenter node takes these topics for its back end ``simulated`` alone."""

from __future__ import annotations

from core_perception.segmenters.base import LABEL_INFO, LABELS

TRUTH_TOPICS = {LABELS: "ground_truth/labels", LABEL_INFO: "ground_truth/label_info"}
