"""Camera faults of `mjtactile bench camera-faults`, each near the strength in its name."""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mjtactile.core.config_fields import entries, from_table
from mjtactile.rig.camera_faults import CameraFaults

SEED = 20261
"""Seed of the sampled strengths; strengths of other seeds were used in tuning."""
_SPREAD = 0.2  # maximum relative change of a strength
_INTEGERS = ("count", "bits", "quality", "yuyv", "Hz")
ALWAYS, RUN, REFERENCES = "always", "run", "references"
"""Periods with the fault: references and run, run only, references only."""


@dataclass(frozen=True)
class Kind:
    """One fault: its name, the fields that it sets in the units of files, and its period."""

    name: str
    table: Mapping[str, Any]
    when: str
    seed: int

    @property
    def faults(self) -> CameraFaults:
        """Return the fault settings of a camera."""
        return from_table(CameraFaults, self.table, self.name)


GOOD = (ALWAYS, RUN)
TABLES: tuple[tuple[str, dict[str, Any], tuple[str, ...]], ...] = (
    ("none", {}, (ALWAYS,)),
    ("JPEG of quality 60", {"jpeg_quality": 60}, GOOD),
    ("JPEG of quality 85", {"jpeg_quality": 85}, GOOD),
    ("YUYV", {"yuyv": 1}, GOOD),
    ("Bayer, colour cast of 30 %", {"bayer_percent": 30}, GOOD),
    ("5 bits", {"bits": 5}, GOOD),
    ("light from one side, 60 %", {"gradient_percent": 60}, GOOD),
    ("30 % darker", {"exposure_percent": -30}, GOOD),
    ("25 % brighter", {"exposure_percent": 25}, GOOD),
    ("auto exposure", {"auto_exposure_DN": 100}, GOOD),
    ("fog of 50 %", {"fog_percent": 50}, GOOD),
    ("3 dead rows", {"dead_row_count": 3}, GOOD),
    ("200 hot pixels", {"hot_pixel_count": 200}, GOOD),
    ("4 scratches", {"scratch_count": 4}, GOOD),
    ("a covered circle", {"dust_count": 1, "dust_px": 15, "dust_dark_percent": 90}, GOOD),
    ("dark dust of 1.1 mm", {"dust_count": 1, "dust_px": 7, "dust_dark_percent": 80}, GOOD),
    ("a grey speck", {"dust_count": 1, "dust_px": 5, "dust_dark_percent": 40}, GOOD),
    ("5 specks", {"dust_count": 5, "dust_px": 4, "dust_dark_percent": 70}, GOOD),
    ("a fingerprint", {"fingerprint_percent": 60}, GOOD),
    ("smear of 80 DN", {"smear_DN": 80}, GOOD),
    ("knock of 0.5 px", {"image_shift_px": [0.5, -0.4]}, (RUN,)),
    ("knock of 2 px", {"image_shift_px": [-1.6, 1.2]}, (RUN,)),
    ("knock of 6 px", {"image_shift_px": [5.0, 3.3]}, (RUN,)),
    ("turn of 0.2 degrees", {"rotation_deg": 0.2}, (RUN,)),
    ("turn of 1 degree", {"rotation_deg": -1.0}, (RUN,)),
    ("zoom by 0.1 %", {"scale_percent": 0.1}, (RUN,)),
    ("zoom by -0.1 %", {"scale_percent": -0.1}, (RUN,)),
    ("zoom by 0.3 %", {"scale_percent": 0.3}, (RUN,)),
    ("zoom by -0.3 %", {"scale_percent": -0.3}, (RUN,)),
    ("zoom by 1 %", {"scale_percent": 1.0}, (RUN,)),
    ("zoom by -1 %", {"scale_percent": -1.0}, (RUN,)),
    ("defocus of 1 px", {"defocus_px": 1.0}, GOOD),
    ("rolling shutter of 25 ms", {"rolling_shutter_ms": 25}, GOOD),
    ("mains flicker of 10 %", {"flicker_percent": 10}, GOOD),
    ("noise reduction of 50 %", {"noise_reduction_percent": 50}, GOOD),
    ("noise reduction of 75 %", {"noise_reduction_percent": 75}, GOOD),
    ("sharpening of 80 %", {"sharpening_percent": 80}, GOOD),
    ("sharpening of 200 %", {"sharpening_percent": 200}, GOOD),
    ("gamma 1.1", {"gamma": 1.1}, GOOD),
    ("gamma 1.3", {"gamma": 1.3}, GOOD),
    ("gamma 0.8", {"gamma": 0.8}, GOOD),
    ("blacks clipped at 50 DN", {"black_DN": 50}, GOOD),
    ("whites clipped at 150 DN", {"white_DN": 150}, GOOD),
    ("overexposed by 60 %", {"exposure_percent": 60}, (*GOOD, REFERENCES)),
    ("torn pictures, 3 %", {"torn_percent": 3}, GOOD),
    ("lost lines, 3 % of pictures", {"lost_lines_percent": 3}, GOOD),
    ("damaged JPEG, 3 %", {"damaged_percent": 3, "jpeg_quality": 85}, GOOD),
    (
        "a shop's webcam",
        {
            "jpeg_quality": 80,
            "yuyv": 1,
            "bayer_percent": 30,
            "rolling_shutter_ms": 25,
            "noise_reduction_percent": 30,
            "sharpening_percent": 40,
        },
        GOOD,
    ),
)


_WORDS = {
    "knock of": "image shift of",
    "turn of": "image rotation of",
    "pictures": "images",
    "a shop's webcam": "consumer webcam",
    "a covered": "covered",
    "a grey": "grey",
    "a fingerprint": "fingerprint",
    "colour cast": "color cast",
}


def label(name: str) -> str:
    """Return the name of a fault for tables and figures.

    The names in `TABLES` are fixed because the strengths are random numbers seeded by them.
    """
    for word, shown in _WORDS.items():
        name = name.replace(word, shown)
    return name


def kinds(seed: int = SEED) -> Iterator[Kind]:
    """Yield all faults, with strengths within a fifth of those in their names.

    Args:
        seed: Seed of the strengths and of the positions of dust.

    Yields:
        One kind for each fault and period.
    """
    for name, table, times in TABLES:
        rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
        sampled = {key: _near(key, value, rng) for key, value in table.items()}
        own = int(rng.integers(2**31))
        yield from (Kind(name, sampled, when, own) for when in times)


def _near(key: str, value: Any, rng: np.random.Generator) -> Any:
    """Return a strength near `value`; counts stay unchanged."""
    if any(key.endswith(unit) or unit in key for unit in _INTEGERS):
        return value
    factor = 1 + _SPREAD * rng.uniform(-1, 1)
    if isinstance(value, list):
        return [factor * item for item in value]
    found = factor * (value - _off(key)) + _off(key)
    return min(found, _ENTRIES[key].high)


_ENTRIES = {entry.key: entry for entry in entries(CameraFaults).values()}


def _off(key: str) -> float:
    """Return the value of a fault parameter without the fault."""
    return {"gamma": 1.0, "white_DN": 255.0}.get(key, 0.0)
