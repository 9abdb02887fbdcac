"""Faults of a camera image.

They are set in `[emulator.as_built.FINGER.camera]` of a rig file. In a randomization file the
section is `[camera]`. All are off by default. For their effects see
mjtactile/sim/rendering/image_faults.
"""

from __future__ import annotations

from dataclasses import dataclass

from mjtactile.core.config_fields import DEGREE, MS, PERCENT, number, numbers


@dataclass(frozen=True)
class CameraFaults:
    """Faults of one camera, in the order of their application."""

    start: float = number(
        "from_s", 0, 1e6, default=0.0, about="start of all faults, on the world's clock"
    )
    zoom: float = number(
        "scale_percent",
        -5,
        5,
        PERCENT,
        default=0.0,
        about="magnification of the image, as by focus breathing",
    )
    knock: tuple[float, float] = numbers(
        "image_shift_px", "uv", -20, 20, default=(0.0, 0.0), about="shift of the image"
    )
    turn: float = number(
        "rotation_deg", -10, 10, DEGREE, default=0.0, about="rotation about the image center"
    )
    defocus: float = number(
        "defocus_px",
        0,
        10,
        default=0.0,
        about="blur (standard deviation) in addition to that of the lens",
    )
    fog: float = number("fog_percent", 0, 90, PERCENT, default=0.0, about="uniform veiling light")
    dust: float = number("dust_count", 0, 200, default=0.0, about="dust specks on the glass")
    dust_radius: float = number("dust_px", 0.5, 50, default=4.0, about="radius of the specks, px")
    dust_darkness: float = number(
        "dust_dark_percent", -30, 100, PERCENT, default=0.8, about="light absorbed by the specks"
    )
    scratches: float = number("scratch_count", 0, 50, default=0.0, about="scratches on the glass")
    fingerprint: float = number(
        "fingerprint_percent",
        0,
        100,
        PERCENT,
        default=0.0,
        about="strength of a fingerprint on the glass",
    )
    gradient: float = number(
        "gradient_percent",
        -90,
        90,
        PERCENT,
        default=0.0,
        about="more light on the right than on the left",
    )
    flicker: float = number(
        "flicker_percent", 0, 50, PERCENT, default=0.0, about="bands due to mains light"
    )
    flicker_rate: float = number(
        "flicker_Hz", 10, 1000, default=100.0, about="frequency of the mains light"
    )
    exposure: float = number(
        "exposure_percent",
        -90,
        300,
        PERCENT,
        default=0.0,
        about="increase of exposure, clipped at white",
    )
    auto_exposure: float = number(
        "auto_exposure_DN", 0, 250, default=0.0, about="controlled mean level; 0: no control"
    )
    rolling: float = number(
        "rolling_shutter_ms", 0, 100, MS, default=0.0, about="delay from the first to the last row"
    )
    smear: float = number("smear_DN", 0, 200, default=0.0, about="added light in some columns")
    hot_pixels: float = number(
        "hot_pixel_count", 0, 10_000, default=0.0, about="white or black pixels"
    )
    dead_rows: float = number("dead_row_count", 0, 50, default=0.0, about="black rows")
    bayer: float = number(
        "bayer_percent",
        0,
        90,
        PERCENT,
        default=0.0,
        about="color mosaic; reduction of red and blue light",
    )
    noise_reduction: float = number(
        "noise_reduction_percent",
        0,
        95,
        PERCENT,
        default=0.0,
        about="fraction of the previous image in the current one",
    )
    sharpening: float = number(
        "sharpening_percent", 0, 400, PERCENT, default=0.0, about="unsharp mask of 1 px"
    )
    gamma: float = number("gamma", 0.2, 5, default=1.0, about="level = light^(1/gamma)")
    black: float = number("black_DN", 0, 200, default=0.0, about="levels below are black")
    white: float = number("white_DN", 30, 255, default=255.0, about="levels above are white")
    bits: float = number("bits", 2, 8, default=8.0, about="bits per level")
    yuyv: float = number("yuyv", 0, 1, default=0.0, about="1: 219 levels, as in YUYV")
    jpeg: float = number("jpeg_quality", 0, 100, default=0.0, about="of JPEG; 0: none")
    damaged: float = number(
        "damaged_percent", 0, 100, PERCENT, default=0.0, about="images with a corrupt JPEG"
    )
    torn: float = number(
        "torn_percent", 0, 100, PERCENT, default=0.0, about="images with half of the previous one"
    )
    lost_lines: float = number(
        "lost_lines_percent", 0, 100, PERCENT, default=0.0, about="images with missing lines"
    )


UNTROUBLED = CameraFaults()
"""A camera with none."""
