"""Faults of a camera image: `[emulator.as_built.FINGER.camera]` of a rig file and `[camera]` of a
randomization file.

All are off by default. For their effects see mjtactile/sim/rendering/image_faults.
"""

from __future__ import annotations

from dataclasses import dataclass

from mjtactile.core.config_fields import DEGREE, MS, PERCENT, number, numbers


@dataclass(frozen=True)
class CameraFaults:
    """Faults of one camera, in the order of their application."""

    start: float = number(
        "from_s", 0, 1e6, default=0.0, about="when all of them begin, on the world's clock"
    )
    zoom: float = number(
        "scale_percent", -5, 5, PERCENT, default=0.0, about="larger picture: a lens that breathes"
    )
    knock: tuple[float, float] = numbers(
        "image_shift_px", "uv", -20, 20, default=(0.0, 0.0), about="shift of the picture"
    )
    turn: float = number("rotation_deg", -10, 10, DEGREE, default=0.0, about="about its middle")
    defocus: float = number("defocus_px", 0, 10, default=0.0, about="blur (sd) beside the lens's")
    fog: float = number("fog_percent", 0, 90, PERCENT, default=0.0, about="veil of even light")
    dust: float = number("dust_count", 0, 200, default=0.0, about="specks on the pane")
    dust_radius: float = number("dust_px", 0.5, 50, default=4.0, about="their radius, px")
    dust_darkness: float = number(
        "dust_dark_percent", -30, 100, PERCENT, default=0.8, about="light that they take"
    )
    scratches: float = number("scratch_count", 0, 50, default=0.0, about="scratches on the pane")
    fingerprint: float = number(
        "fingerprint_percent", 0, 100, PERCENT, default=0.0, about="how greasy one on the pane is"
    )
    gradient: float = number(
        "gradient_percent", -90, 90, PERCENT, default=0.0, about="more light right than left"
    )
    flicker: float = number(
        "flicker_percent", 0, 50, PERCENT, default=0.0, about="bands of mains light"
    )
    flicker_rate: float = number("flicker_Hz", 10, 1000, default=100.0, about="of the mains light")
    exposure: float = number(
        "exposure_percent", -90, 300, PERCENT, default=0.0, about="more light, clipped at white"
    )
    auto_exposure: float = number(
        "auto_exposure_DN", 0, 250, default=0.0, about="mean level that it holds; 0: it does not"
    )
    rolling: float = number(
        "rolling_shutter_ms", 0, 100, MS, default=0.0, about="first row before the last"
    )
    smear: float = number("smear_DN", 0, 200, default=0.0, about="light in some columns")
    hot_pixels: float = number("hot_pixel_count", 0, 10_000, default=0.0, about="white or black")
    dead_rows: float = number("dead_row_count", 0, 50, default=0.0, about="black rows")
    bayer: float = number(
        "bayer_percent",
        0,
        90,
        PERCENT,
        default=0.0,
        about="colour mosaic, by so much less red and blue light",
    )
    noise_reduction: float = number(
        "noise_reduction_percent",
        0,
        95,
        PERCENT,
        default=0.0,
        about="share of the last picture in this one",
    )
    sharpening: float = number(
        "sharpening_percent", 0, 400, PERCENT, default=0.0, about="unsharp mask of 1 px"
    )
    gamma: float = number("gamma", 0.2, 5, default=1.0, about="level = light^(1/gamma)")
    black: float = number("black_DN", 0, 200, default=0.0, about="levels below are black")
    white: float = number("white_DN", 30, 255, default=255.0, about="levels above are white")
    bits: float = number("bits", 2, 8, default=8.0, about="of a level")
    yuyv: float = number("yuyv", 0, 1, default=0.0, about="1: 219 levels, as YUYV has")
    jpeg: float = number("jpeg_quality", 0, 100, default=0.0, about="of JPEG; 0: none")
    damaged: float = number(
        "damaged_percent", 0, 100, PERCENT, default=0.0, about="pictures with a broken JPEG"
    )
    torn: float = number(
        "torn_percent", 0, 100, PERCENT, default=0.0, about="pictures half of the one before"
    )
    lost_lines: float = number(
        "lost_lines_percent", 0, 100, PERCENT, default=0.0, about="pictures that lost some lines"
    )


UNTROUBLED = CameraFaults()
"""A camera with none."""
