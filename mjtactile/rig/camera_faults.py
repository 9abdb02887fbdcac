"""Faults of a camera image.

They are set in `[emulator.as_built.FINGER.camera]` of a rig file. In a randomization file the
section is `[camera]`. All are off by default. For their effects see
mjtactile/sim/rendering/image_faults.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from mjtactile.core.config_fields import DEGREE, MS, PERCENT, number, numbers

_fault = partial(number, default=0.0)


@dataclass(frozen=True)
class CameraFaults:
    """Faults of one camera, in the order of their application."""

    start: float = _fault("from_s", 0, 1e6, about="start of all faults, on the world's clock")
    zoom: float = _fault(
        "scale_percent", -5, 5, PERCENT, about="magnification, as by focus breathing"
    )
    shift: tuple[float, float] = numbers(
        "image_shift_px", "uv", -20, 20, default=(0.0, 0.0), about="shift of the image"
    )
    rotation: float = _fault(
        "rotation_deg", -10, 10, DEGREE, about="rotation about the image center"
    )
    defocus: float = _fault("defocus_px", 0, 10, about="blur (sd) in addition to the lens's")
    fog: float = _fault("fog_percent", 0, 90, PERCENT, about="uniform veiling light")
    dust: float = _fault("dust_count", 0, 200, about="dust specks on the glass")
    dust_radius: float = _fault("dust_px", 0.5, 50, default=4.0, about="radius of the specks, px")
    dust_darkness: float = _fault(
        "dust_dark_percent", -30, 100, PERCENT, default=0.8, about="light absorbed by the specks"
    )
    scratches: float = _fault("scratch_count", 0, 50, about="scratches on the glass")
    fingerprint: float = _fault(
        "fingerprint_percent", 0, 100, PERCENT, about="fingerprint on the glass"
    )
    gradient: float = _fault("gradient_percent", -90, 90, PERCENT, about="more light on the right")
    flicker: float = _fault("flicker_percent", 0, 50, PERCENT, about="bands due to mains light")
    flicker_rate: float = _fault(
        "flicker_Hz", 10, 1000, default=100.0, about="frequency of the mains light"
    )
    exposure: float = _fault(
        "exposure_percent", -90, 300, PERCENT, about="more exposure, clipped at white"
    )
    auto_exposure: float = _fault(
        "auto_exposure_DN", 0, 250, about="controlled mean level; 0: no control"
    )
    rolling: float = _fault(
        "rolling_shutter_ms", 0, 100, MS, about="delay from the first to the last row"
    )
    smear: float = _fault("smear_DN", 0, 200, about="added light in some columns")
    hot_pixels: float = _fault("hot_pixel_count", 0, 10_000, about="white or black pixels")
    dead_rows: float = _fault("dead_row_count", 0, 50, about="black rows")
    bayer: float = _fault(
        "bayer_percent", 0, 90, PERCENT, about="color mosaic; less red and blue light"
    )
    noise_reduction: float = _fault(
        "noise_reduction_percent", 0, 95, PERCENT, about="fraction of the previous image"
    )
    sharpening: float = _fault("sharpening_percent", 0, 400, PERCENT, about="unsharp mask of 1 px")
    gamma: float = _fault("gamma", 0.2, 5, default=1.0, about="level = light^(1/gamma)")
    black: float = _fault("black_DN", 0, 200, about="levels below are black")
    white: float = _fault("white_DN", 30, 255, default=255.0, about="levels above are white")
    bits: float = _fault("bits", 2, 8, default=8.0, about="bits per level")
    yuyv: float = _fault("yuyv", 0, 1, about="1: 219 levels, as in YUYV")
    jpeg: float = _fault("jpeg_quality", 0, 100, about="of JPEG; 0: none")
    damaged: float = _fault("damaged_percent", 0, 100, PERCENT, about="images with a corrupt JPEG")
    torn: float = _fault(
        "torn_percent", 0, 100, PERCENT, about="images with half of the previous one"
    )
    lost_lines: float = _fault(
        "lost_lines_percent", 0, 100, PERCENT, about="images with missing lines"
    )


NO_CAMERA_FAULTS = CameraFaults()
"""A camera with none."""
