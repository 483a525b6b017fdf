# SPDX-License-Identifier: BSD-3-Clause
"""Once a second: what the filter does, as diagnostic_msgs/DiagnosticArray."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from core_control.types import FilterResult, Mode

LEVELS = {
    Mode.NOMINAL: DiagnosticStatus.OK,
    Mode.FILTERED: DiagnosticStatus.OK,
    Mode.HOLD: DiagnosticStatus.WARN,
    Mode.DISABLED: DiagnosticStatus.WARN,
    Mode.STOPPED: DiagnosticStatus.ERROR,
}


def make_diagnostics(result: FilterResult, name: str, ticks: int, stamp) -> DiagnosticArray:
    """DiagnosticArray with one status; stamp is a genpy.Time."""
    status = DiagnosticStatus(level=LEVELS[result.mode], name=f"{name}: filter", hardware_id=name)
    status.message = ": ".join(part for part in (result.mode.name, result.reason) if part)
    figures = {
        "detail": result.detail,
        "ticks": ticks,
        "h_m": f"{result.h_m:.3f}",
        "speed_cap_mps": f"{result.speed_cap_mps:.3f}",
        "rows": result.rows,
        "solve_time_s": f"{result.solve_time_s:.6f}",
    }
    status.values = [KeyValue(key, str(value)) for key, value in figures.items()]
    message = DiagnosticArray(status=[status])
    message.header.stamp = stamp
    return message
