"""Calibration of camera pose, marker sizes and membrane rest state from the sensor's own images."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mjtactile.calibrate.result_io import stamp_of
from mjtactile.core.calibration import Calibration
from mjtactile.core.calibration_parts import FrameCalibration, RestMarkers
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import DeviceError
from mjtactile.core.types import Image
from mjtactile.sensing.stateful_pipeline import StatefulPipeline

# Marker centers in focus are accurate to 0.05 px; a bent frame or a wrong lens exceeds the limit.
RESIDUAL_MAX_PX = 1.0


def calibrate_frame(
    design: SensorDesign,
    calibration: Calibration,
    flat: Sequence[Image],
    rest: Sequence[Image],
    gauge_pressure: float,
    *,
    sealed: bool = True,
) -> tuple[FrameCalibration | None, dict[str, Any], list[str]]:
    """Calibrate the frame part; return it (None: not measurable), a report, and reasons to refuse
    it.

    `flat` are images of the membrane with the valve open. `rest` (may be empty) are images of the
    membrane inflated to `gauge_pressure` Pa.
    """
    perception = StatefulPipeline.of(design, calibration)
    try:
        found = perception.measure_flat_reference(flat)
        markers = (
            perception.measure_rest_reference(rest, gauge_pressure, sealed=sealed) if rest else None
        )
    except DeviceError as error:  # the images do not match the sensor file
        return None, {"sensor": design.name, "images": len(flat)}, [str(error)]
    reference = perception.state.reference
    stiffness = None if reference is None else reference.rest.stiffness_scale
    tilt = np.degrees(np.arccos(np.clip((np.trace(found.R_SC) - 1) / 2, -1, 1)))
    radii = 1e3 * design.markers.radius * np.array([found.scale.min(), found.scale.max()])
    report = {
        "sensor": design.name,
        "images": len(flat),
        "residual_px": found.residual_px,
        "scale_sd": found.scale_sd,
        "radius_mm": radii,
        "offset_mm": 1e3 * (found.p_SC - design.camera.p_SC),
        "tilt_deg": tilt,
        "rest_stiffness_scale": stiffness,
    }
    if design.fiducials is not None and markers is not None and markers.fiducials is not None:
        report["fiducials"] = len(markers.fiducials)
    part = FrameCalibration(
        found.R_SC,
        found.p_SC,
        found.scale,
        found.residual_px,
        found.scale_sd,
        stamp_of(design, report),
        None if markers is None else RestMarkers(markers, gauge_pressure, sealed),
        stiffness,
    )
    reasons = [
        f"the marker centers deviate by {found.residual_px:.2f} px rms (allowed: "
        f"{RESIDUAL_MAX_PX:g}): check the camera calibration, the marker positions in the "
        "sensor file, and that nothing touches the membrane"
    ] * (found.residual_px > RESIDUAL_MAX_PX)
    return part, report, reasons
