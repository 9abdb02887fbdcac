"""The chip: exposure, rows that are read one after the other, pixels that are broken, colours."""

from __future__ import annotations

import cv2
import numpy as np

from mjtactile.rig.camera_faults import CameraFaults
from mjtactile.sim.rendering.image_faults.fault_context import FaultContext, Floats, Step

_MAX_GAIN = 8.0
_SMEARS = 3
_SMEAR_WIDTH = 4.0  # px, sd


def exposed(pixels: Floats, t: CameraFaults, shot: FaultContext) -> Floats:
    """Increase the light; excess levels become white."""
    return np.clip((1 + t.exposure) * pixels, 0, 255)


def exposed_by_itself(pixels: Floats, t: CameraFaults, shot: FaultContext) -> Floats:
    """Apply the gain that would give the previous image the target mean."""
    seen = pixels if shot.last is None else shot.last[1]
    gain = np.float32(min(t.auto_exposure / max(float(seen.mean()), 1.0), _MAX_GAIN))
    return np.clip(gain * pixels, 0, 255)


def rolling(pixels: Floats, t: CameraFaults, shot: FaultContext) -> Floats:
    """Make the rows above the last older, as a rolling shutter does, to first order in the
    motion."""
    if shot.last is None or shot.time <= shot.last[0]:
        return pixels
    height = pixels.shape[0]
    older = t.rolling / (shot.time - shot.last[0]) * (1 - np.arange(height) / height)
    share = np.minimum(older, 1.0).astype(np.float32)[:, None]
    return (1 - share) * pixels + share * shot.last[1]


def smeared(pixels: Floats, t: CameraFaults, shot: FaultContext) -> Floats:
    """Light that leaks along columns."""
    columns = shot.fixed.uniform(0.15, 0.85, _SMEARS) * pixels.shape[1]
    u = np.arange(pixels.shape[1])
    light = np.exp(-0.5 * ((u - columns[:, None]) / _SMEAR_WIDTH) ** 2).sum(axis=0)
    return np.clip(pixels + np.float32(t.smear) * light.astype(np.float32), 0, 255)


def with_hot_pixels(pixels: Floats, t: CameraFaults, shot: FaultContext) -> Floats:
    """Half of them are white, half black."""
    rng = shot.fixed
    changed = pixels.copy()
    places = rng.choice(pixels.size, min(round(t.hot_pixels), pixels.size), replace=False)
    changed.flat[places] = 255.0 * (rng.random(len(places)) < 0.5)
    return changed


def with_dead_rows(pixels: Floats, t: CameraFaults, shot: FaultContext) -> Floats:
    """Black."""
    changed = pixels.copy()
    rows = round(t.dead_rows)
    changed[shot.fixed.choice(pixels.shape[0], min(rows, pixels.shape[0]), replace=False)] = 0
    return changed


def mosaic(pixels: Floats, t: CameraFaults, shot: FaultContext) -> Floats:
    """Record one color per pixel and interpolate the others, with correct white balance."""
    share = np.float32(1 - t.bayer)
    raw = pixels.copy()
    raw[::2, ::2] *= share
    raw[1::2, 1::2] *= share
    eight = np.clip(np.rint(raw), 0, 255).astype(np.uint8)
    colour = cv2.cvtColor(eight, cv2.COLOR_BayerBG2BGR).astype(np.float32)
    colour[..., [0, 2]] /= share
    return np.asarray(np.clip(colour, 0, 255).mean(axis=2), np.float32)


STEPS = (
    Step("exposed", ("exposure",), exposed),
    Step("exposed by itself", ("auto_exposure",), exposed_by_itself),
    Step("rolling", ("rolling",), rolling),
    Step("smeared", ("smear",), smeared),
    Step("hot pixels", ("hot_pixels",), with_hot_pixels),
    Step("dead rows", ("dead_rows",), with_dead_rows),
    Step("mosaic", ("bayer",), mosaic),
)
