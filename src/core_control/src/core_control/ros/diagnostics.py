# SPDX-License-Identifier: BSD-3-Clause
"""Once a second: what the filter does, as diagnostic_msgs/DiagnosticArray."""

from __future__ import annotations

from typing import Sequence

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from core_control.types import FilterResult, Mode

LEVELS = {
    Mode.NOMINAL: DiagnosticStatus.OK,
    Mode.FILTERED: DiagnosticStatus.OK,
    Mode.HOLD: DiagnosticStatus.WARN,
    Mode.DISABLED: DiagnosticStatus.WARN,
    Mode.STOPPED: DiagnosticStatus.ERROR,
    Mode.ESCAPE: DiagnosticStatus.WARN,
    Mode.OVERRIDE: DiagnosticStatus.WARN,
}


def make_diagnostics(
    result: FilterResult, name: str, ticks: int, stamp, overruns: int = 0, warnings: Sequence[str] = ()
) -> DiagnosticArray:
    """DiagnosticArray with one status, at least WARN with a warning; stamp is a genpy.Time."""
    level = max(LEVELS[result.mode], DiagnosticStatus.WARN if result.blocked_s > 0.0 else DiagnosticStatus.OK)
    status = DiagnosticStatus(level=level, name=f"{name}: filter", hardware_id=name)
    parts = [": ".join(part for part in (result.mode.name, result.reason) if part), *warnings]
    status.message = "; ".join(parts)
    if warnings:
        status.level = max(status.level, DiagnosticStatus.WARN)
    figures = {
        "detail": result.detail,
        "ticks": ticks,
        "overruns": overruns,
        "h_m": f"{result.h_m:.3f}",
        "speed_cap_mps": f"{result.speed_cap_mps:.3f}",
        "blocked_s": f"{result.blocked_s:.1f}",
        "rows": result.rows,
        "solve_time_s": f"{result.solve_time_s:.6f}",
    }
    status.values = [KeyValue(key, str(value)) for key, value in figures.items()]
    message = DiagnosticArray(status=[status])
    message.header.stamp = stamp
    return message
