"""Operating curve of slip detection: slips in time against false alarms, over the thresholds.

A scale of 2 requires twice the evidence, and a more uniform shear. Each image is classified once at
each scale, with a separate history. Scale 1 is the detector of the pipeline.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.slip.score import ROUNDING, SLIPS, Frame, outcome
from mjtactile.core.types import Touch
from mjtactile.sensing.pipeline import SensingPipeline
from mjtactile.sensing.pipeline_state import PipelineState
from mjtactile.sensing.settings import SlipSettings
from mjtactile.sensing.touch import slip

SCALES = (0.5, 0.7, 1.0, 1.4, 2.0, 3.0)
_UNIFORM_POWER = -0.25  # of the scale in the limits of uniform shear


@dataclass(frozen=True)
class Alarms:
    """Result of one scale in one finger's case: the `outcome` (one of OUTCOMES), its `latency`, s,
    and the number of `alarms`, each the first of successive images with slip."""

    outcome: str
    latency: float
    alarms: int


def scaled(settings: SlipSettings, scale: float) -> SlipSettings:
    """Return the settings with all limits of the evidence scaled."""
    uniform = scale**_UNIFORM_POWER
    return replace(
        settings,
        evidence=settings.evidence * scale,
        evidence_uneven=settings.evidence_uneven * scale,
        even=settings.even * uniform,
        uniform_rotation=settings.uniform_rotation * uniform,
    )


class ScaledDetectors:
    """Detectors of one finger, one for each of `SCALES`, on the shape that the pipeline fits."""

    def __init__(self, sensing_pipeline: SensingPipeline) -> None:
        self._inverse = sensing_pipeline.inverse
        self._settings = [scaled(sensing_pipeline.settings.slip, scale) for scale in SCALES]
        self._histories: list[slip.SlipHistory | None] = [None] * len(SCALES)

    def detect(self, touch: Touch, state: PipelineState) -> tuple[bool, ...]:
        """Return, for each scale, True if this image shows slip. An image without a valid estimate
        shows none and leaves the histories unchanged."""
        if touch.status != "ok" or state.shape is None:
            return (False,) * len(SCALES)
        found = [
            slip.classify(touch.time, self._inverse, state.shape, touch.patches, history, settings)
            for settings, history in zip(self._settings, self._histories, strict=True)
        ]
        self._histories = [history for _, history in found]
        return tuple(state.state == "slipping" for state, _ in found)


def alarms(frames: Sequence[Frame], signs: Sequence[Sequence[bool]]) -> list[Alarms]:
    """Score each scale; `signs` holds the results of `ScaledDetectors.detect` of each frame."""
    result = []
    for column in zip(*signs, strict=True):
        states = ["slipping" if sign else "sticking" for sign in column]
        named = [replace(frame, state=state) for frame, state in zip(frames, states, strict=True)]
        starts = np.diff(np.array(column, int), prepend=0) > 0
        found = outcome(named)
        result.append(Alarms(found.name, found.latency, int(starts.sum())))
    return result


def curve(rows: Sequence[Mapping[str, Any]], limit: float | None = None) -> list[dict[str, float]]:
    """Return one point of the curve for each scale.

    Args:
        rows: Rows of fingers with `scales`, a list of `Alarms` as mappings, and the duration of the
            case, `seconds`.
        limit: Maximum latency of a detection in time, s (None: the outcome "in time").

    Returns:
        `scale`, `in_time` (fraction of slips), `holds_alarmed` (fraction of holds) and `per_minute`
        (false alarms per minute of hold).
    """
    points = []
    for k, scale in enumerate(SCALES):
        found = [(row["scales"][k], row["seconds"]) for row in rows]
        slips = [_is_in_time(one, limit) for one, _ in found if one["outcome"] in SLIPS]
        holds = [(one, time) for one, time in found if one["outcome"] in ("quiet", "false")]
        minutes = sum(time for _, time in holds) / 60
        points.append(
            {
                "scale": scale,
                "in_time": sum(slips) / max(len(slips), 1),
                "holds_alarmed": sum(one["outcome"] == "false" for one, _ in holds)
                / max(len(holds), 1),
                "per_minute": sum(one["alarms"] for one, _ in holds) / max(minutes, 1e-9),
            }
        )
    return points


def _is_in_time(one: Mapping[str, Any], limit: float | None) -> bool:
    if limit is None:
        return one["outcome"] == "in time"
    return one["outcome"] not in ("missed", "early") and one["latency"] <= limit + ROUNDING


def table(passive: Sequence[Mapping[str, float]], tested: Sequence[Mapping[str, float]]) -> str:
    """Return the curves as Markdown: without and, if there is one, with the active test."""
    lines = [
        "| evidence required, relative | passive: in time | holds with a false alarm "
        "| false alarms per minute of hold | with the active test: in time | holds | per minute |",
        "|---" * 7 + "|",
    ]
    for k, scale in enumerate(SCALES):
        cells = [
            f"{100 * points[k]['in_time']:.0f} % | {100 * points[k]['holds_alarmed']:.0f} % "
            f"| {points[k]['per_minute']:.1f}"
            if points
            else " | | "
            for points in (passive, tested)
        ]
        lines.append(f"| {scale:g} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"
