"""Faults of the image sensor, the camera's processor and the transmission."""

from __future__ import annotations

import cv2
import numpy as np

from mjtactile.rig.camera_faults import CameraFaults
from mjtactile.sim.rendering.image_faults.optics import FaultContext, Floats, Step

_MAX_GAIN = 8.0
_SMEARS = 3
_SMEAR_WIDTH = 4.0  # px, sd


def exposed(pixels: Floats, t: CameraFaults, shot: FaultContext) -> Floats:
    """Increase the light; excess levels become white."""
    return np.clip((1 + t.exposure) * pixels, 0, 255)


def exposed_by_itself(pixels: Floats, t: CameraFaults, shot: FaultContext) -> Floats:
    """Apply the gain that would give the previous image the target mean."""
    levels = pixels if shot.last is None else shot.last[1]
    gain = np.float32(min(t.auto_exposure / max(float(levels.mean()), 1.0), _MAX_GAIN))
    return np.clip(gain * pixels, 0, 255)


def rolling(pixels: Floats, t: CameraFaults, shot: FaultContext) -> Floats:
    """Make the rows above the last older, as a rolling shutter does, to first order in the
    motion."""
    if shot.last is None or shot.time <= shot.last[0]:
        return pixels
    height = pixels.shape[0]
    older = t.rolling / (shot.time - shot.last[0]) * (1 - np.arange(height) / height)
    fraction = np.minimum(older, 1.0).astype(np.float32)[:, None]
    return (1 - fraction) * pixels + fraction * shot.last[1]


def smeared(pixels: Floats, t: CameraFaults, shot: FaultContext) -> Floats:
    """Add light that leaks along columns."""
    columns = shot.fixed.uniform(0.15, 0.85, _SMEARS) * pixels.shape[1]
    u = np.arange(pixels.shape[1])
    light = np.exp(-0.5 * ((u - columns[:, None]) / _SMEAR_WIDTH) ** 2).sum(axis=0)
    return np.clip(pixels + np.float32(t.smear) * light.astype(np.float32), 0, 255)


def with_hot_pixels(pixels: Floats, t: CameraFaults, shot: FaultContext) -> Floats:
    """Set random pixels to white or black, half each on average."""
    rng = shot.fixed
    changed = pixels.copy()
    indices = rng.choice(pixels.size, min(round(t.hot_pixels), pixels.size), replace=False)
    changed.flat[indices] = 255.0 * (rng.random(len(indices)) < 0.5)
    return changed


def with_dead_rows(pixels: Floats, t: CameraFaults, shot: FaultContext) -> Floats:
    """Set random rows to black."""
    changed = pixels.copy()
    rows = round(t.dead_rows)
    changed[shot.fixed.choice(pixels.shape[0], min(rows, pixels.shape[0]), replace=False)] = 0
    return changed


def mosaic(pixels: Floats, t: CameraFaults, shot: FaultContext) -> Floats:
    """Record one color per pixel and interpolate the others, with correct white balance."""
    fraction = np.float32(1 - t.bayer)
    raw = pixels.copy()
    raw[::2, ::2] *= fraction
    raw[1::2, 1::2] *= fraction
    eight = np.clip(np.rint(raw), 0, 255).astype(np.uint8)
    colour = cv2.cvtColor(eight, cv2.COLOR_BayerBG2BGR).astype(np.float32)
    colour[..., [0, 2]] /= fraction
    return np.asarray(np.clip(colour, 0, 255).mean(axis=2), np.float32)


_MASK = 1.0  # px, sd of the unsharp mask
_STUDIO = (16.0, 219.0)  # black, and levels from there to white, of YUYV
_BROKEN_BYTES = 3
_HEAD = 700  # number of header bytes of a JPEG
_MAX_LINES = 12
_QUALITY = 90  # quality of broken JPEGs if none is specified


def less_noisy(pixels: Floats, t: CameraFaults, shot: FaultContext) -> Floats:
    """Mix in a fraction of the last output: noise falls, and motion lags."""
    if shot.last is None:
        return pixels
    mixed = (1 - t.noise_reduction) * pixels + t.noise_reduction * shot.last[2]
    return np.asarray(mixed, np.float32)


def sharpened(pixels: Floats, t: CameraFaults, shot: FaultContext) -> Floats:
    """Apply an unsharp mask: edges overshoot."""
    return np.clip(
        pixels + t.sharpening * (pixels - cv2.GaussianBlur(pixels, (0, 0), _MASK)), 0, 255
    )


def by_gamma(pixels: Floats, t: CameraFaults, shot: FaultContext) -> Floats:
    """Set each level to light^(1/gamma), with unchanged black and white."""
    light = np.maximum(pixels, 0) / 255
    return np.asarray(255 * light ** np.float32(1 / t.gamma), np.float32)


def clipped(pixels: Floats, t: CameraFaults, shot: FaultContext) -> Floats:
    """Clip the levels to the range from `black` to `white`."""
    inside = (pixels > t.black) & (pixels < t.white)
    return np.where(inside, pixels, np.where(pixels <= t.black, t.black, t.white)).astype(
        np.float32
    )


def coarse(pixels: Floats, t: CameraFaults, shot: FaultContext) -> Floats:
    """Quantize the levels to `bits` bits."""
    step = 2.0 ** (8 - round(t.bits))
    return np.asarray(np.floor(pixels / step) * step + (step - 1) / 2, np.float32)


def studio_range(pixels: Floats, t: CameraFaults, shot: FaultContext) -> Floats:
    """Convert to the 219 levels of video range and back."""
    low, span = _STUDIO
    if t.yuyv < 0.5:
        return pixels
    sent = np.rint(low + np.clip(pixels, 0, 255) * (span / 255))
    return np.asarray(np.rint((sent - low) * (255 / span)), np.float32)


def compressed(pixels: Floats, t: CameraFaults, shot: FaultContext) -> Floats:
    """Encode as JPEG and decode; a damaged one may give the previous image."""
    eight = np.clip(np.rint(pixels), 0, 255).astype(np.uint8)
    quality = round(t.jpeg) or _QUALITY
    data = cv2.imencode(".jpg", eight, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].copy()
    rng = shot.own
    if rng.random() < t.damaged and len(data) > _HEAD + _BROKEN_BYTES:
        data[rng.integers(_HEAD, len(data), _BROKEN_BYTES)] ^= 0x5A
    found = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)
    if found is None or found.shape != pixels.shape:
        return pixels if shot.last is None else shot.last[2]
    return found.astype(np.float32)


def torn(pixels: Floats, t: CameraFaults, shot: FaultContext) -> Floats:
    """Replace the rows below a random row by those of the previous image."""
    rng = shot.own
    if shot.last is None or rng.random() >= t.torn:
        return pixels
    row = int(rng.uniform(0.2, 0.8) * pixels.shape[0])
    return np.concatenate([pixels[:row], shot.last[1][row:]])


def without_lines(pixels: Floats, t: CameraFaults, shot: FaultContext) -> Floats:
    """Remove some lines: the lines below move up; the last ones are those of the last image."""
    rng = shot.own
    if shot.last is None or rng.random() >= t.lost_lines:
        return pixels
    row = int(rng.uniform(0.2, 0.8) * pixels.shape[0])
    lines = int(rng.integers(1, _MAX_LINES + 1))
    return np.concatenate([pixels[:row], pixels[row + lines :], shot.last[1][-lines:]])


STEPS = (
    Step("exposed", ("exposure",), exposed),
    Step("exposed by itself", ("auto_exposure",), exposed_by_itself),
    Step("rolling", ("rolling",), rolling),
    Step("smeared", ("smear",), smeared),
    Step("hot pixels", ("hot_pixels",), with_hot_pixels),
    Step("dead rows", ("dead_rows",), with_dead_rows),
    Step("mosaic", ("bayer",), mosaic),
    Step("less noisy", ("noise_reduction",), less_noisy),
    Step("sharpened", ("sharpening",), sharpened),
    Step("by gamma", ("gamma",), by_gamma),
    Step("clipped", ("black", "white"), clipped),
    Step("coarse", ("bits",), coarse),
    Step("studio range", ("yuyv",), studio_range),
    Step("compressed", ("jpeg", "damaged"), compressed),
    Step("torn", ("torn",), torn),
    Step("without lines", ("lost_lines",), without_lines),
)
