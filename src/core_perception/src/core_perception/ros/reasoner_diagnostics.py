# SPDX-License-Identifier: BSD-3-Clause
"""What safety_reasoner tells on ``diagnostics``."""

from __future__ import annotations

import rospy
from diagnostic_msgs.msg import DiagnosticStatus

from core_perception.asking import Findings
from core_perception.ros.diagnostics import make_status

FAILURES_WORTH_A_WARNING = 3


def describe(findings: Findings, description: str, rule_count: int) -> DiagnosticStatus:
    """Compose one status: OK, WARN after failures in a row, ERROR while nothing has been answered.

    Args:
        findings: answers so far.
        description: which reasoner answers, and why that one.
        rule_count: rules of the operator.
    """
    now = rospy.Time.now()
    constraints = findings.constraints
    level, message = DiagnosticStatus.OK, "answering"
    if constraints.image_stamp_ns is None:
        why = "no answer has named safe ground yet" if constraints.predicates else "no answer yet"
        level, message = DiagnosticStatus.ERROR, f"{why}: the robot does not move"
    if findings.failures_in_row >= FAILURES_WORTH_A_WARNING:
        level = max(level, DiagnosticStatus.WARN)
        message = f"{findings.failures_in_row} answers in a row failed, the last: {findings.last_failure}"
    values = {
        "reasoner": description,
        "source": constraints.source,
        "latency_s": f"{constraints.latency_ns * 1e-9:.3f}",
        "age_s": ""
        if constraints.image_stamp_ns is None
        else f"{now.to_sec() - constraints.image_stamp_ns * 1e-9:.3f}",
        "predicates": str(len(constraints.predicates)),
        "operator_rules": str(rule_count),
        "failures_in_row": str(findings.failures_in_row),
        **{name: str(count) for name, count in sorted(findings.counts.items())},
    }
    return make_status("contextual reasoning", level, message, values)
