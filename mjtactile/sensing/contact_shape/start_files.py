"""Files of the networks that start the fits: one per sensor, shipped or made on demand and cached
(docs/theory/contact_shape.md, Eq. F27)."""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import tempfile
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np

from mjtactile.core import resources
from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array
from mjtactile.sensing.contact_shape.amortized_start import AmortizedStart, trained
from mjtactile.sensing.contact_shape.forward_model import ForwardModel
from mjtactile.sensing.contact_shape.network import Network
from mjtactile.sensing.contact_shape.press_view import PressView
from mjtactile.sensing.contact_shape.primitives import (
    EDGE,
    ROUNDING,
    InitialGuess,
    feasible_half_extents,
)
from mjtactile.sensing.contact_shape.random_presses import Presses, press_guess, random_presses
from mjtactile.sensing.settings import ContactShapeSettings

_VERSION = 1
_SHIPPED = "models/contact_shapes"
_PRESSURES = (0.94, 1.0, 1.06)  # fractions of the supply pressure
_PRESSES = 8000  # at each pressure
_ROUNDS = 100
_MARKER_SD = 19e-6  # m
_USABLE = 1.1  # ratio to the supply pressure up to which a network is used

Notify = Callable[[str], None]


def load_start(
    design: SensorDesign, gauge_pressure: float, s: ContactShapeSettings
) -> AmortizedStart | None:
    """Return the network of a sensor; None: there is none. It is valid near the supply pressure,
    Pa."""
    ratio = gauge_pressure / design.chamber.supply_gauge
    if not 1 / _USABLE < ratio < _USABLE:
        return None
    return _loaded(design, fingerprint(design, s))


@lru_cache(maxsize=16)
def _loaded(design: SensorDesign, name: str) -> AmortizedStart | None:
    for folder in (resources.folder(_SHIPPED), _cache()):
        path = folder / f"{name}.npz"
        with contextlib.suppress(OSError, ValueError, KeyError), np.load(path) as file:
            return _unpacked(design, dict(file))
    return None


def ensure_start(
    design: SensorDesign, s: ContactShapeSettings, notify: Notify = lambda _: None
) -> AmortizedStart:
    """Return the network of a sensor; make it if there is none, in about a minute, and keep it."""
    name = fingerprint(design, s)
    found = _loaded(design, name)
    if found is not None:
        return found
    start = make_start(design, s, notify)
    with contextlib.suppress(OSError):  # a cache that cannot be written costs time only
        keep_start(_cache(), name, start)
    _loaded.cache_clear()
    return start


def make_start(
    design: SensorDesign,
    s: ContactShapeSettings,
    notify: Notify = lambda _: None,
    presses: int = _PRESSES,
    rounds: int = _ROUNDS,
) -> AmortizedStart:
    """Fit the network of a sensor to random presses.

    Args:
        design: Sensor.
        s: Settings.
        notify: Receiver of progress messages.
        presses: Number of presses at each pressure.
        rounds: Number of rounds over the presses.
    """
    rng = np.random.default_rng(_VERSION)
    notify(f"sensor {design.name}: simulating {len(_PRESSURES) * presses} presses, once per sensor")
    every = Presses.joined([_presses_at(design, s, ratio, presses, rng) for ratio in _PRESSURES])
    sd = float(np.hypot(_MARKER_SD, s.membrane_sd))
    view = PressView.of(design, every.heights, every.force, every.center, sd)
    notify(f"sensor {design.name}: fitting the start of contact shapes")
    for start in trained(every, view, sd, rounds, rng):
        found = start
    return _unpacked(design, _packed(found))


def _presses_at(
    design: SensorDesign,
    s: ContactShapeSettings,
    ratio: float,
    count: int,
    rng: np.random.Generator,
) -> Presses:
    forward = ForwardModel(design, None, s.spacing, ratio * design.chamber.supply_gauge)
    return random_presses(forward, reference_guess(forward), count, rng, s)


def reference_guess(forward: ForwardModel) -> InitialGuess:
    """Return the guess that the parameters of a network are relative to."""
    frame = forward.membrane.design.frame
    half = feasible_half_extents(frame, EDGE)
    return press_guess(forward, half, ROUNDING * forward.spacing, frame.outline is not None)


def fingerprint(design: SensorDesign, s: ContactShapeSettings) -> str:
    """Return the name of the file of a sensor."""
    digest = hashlib.sha256()
    chamber = design.chamber
    values = (
        _VERSION,
        design.frame.length,
        design.frame.width,
        design.membrane,
        chamber.supply_gauge,
        chamber.ambient,
        chamber.polytropic_exponent,
        chamber.depth,
        s.spacing,
        s.membrane_sd,
    )
    digest.update(repr(values).encode())
    digest.update(np.round(1e6 * design.markers.p_SM).astype(np.int64).tobytes())
    if design.frame.outline is not None:
        digest.update(np.round(1e6 * design.frame.outline.points(64)).astype(np.int64).tobytes())
    return digest.hexdigest()[:16]


def keep_start(folder: Path, name: str, start: AmortizedStart) -> Path:
    """Write a network to its file in `folder`. Other processes may read it meanwhile."""
    folder.mkdir(parents=True, exist_ok=True)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **_packed(start))  # type: ignore[arg-type]
    with tempfile.NamedTemporaryFile(dir=folder, delete=False) as file:
        file.write(buffer.getvalue())
    path = folder / f"{name}.npz"
    Path(file.name).replace(path)
    path.chmod(0o644)
    return path


def _cache() -> Path:
    root = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(root) / "mjtactile" / "contact_shapes"


def _packed(start: AmortizedStart) -> dict[str, Array]:
    """Return the arrays of a file. Half precision is enough for a start."""
    arrays = {
        "moments": start.view.moments.astype(np.float32),
        "rows": (1e6 * start.view.rows).astype(np.float16),
        "sd": np.array(start.view.sd),
        "inputs": start.inputs.astype(np.float32),
        "scale": start.scale.astype(np.float32),
    }
    for index, (weight, offset) in enumerate(start.network.layers):
        arrays[f"weight{index}"] = weight.astype(np.float16)
        arrays[f"offset{index}"] = offset.astype(np.float16)
    return arrays


def _unpacked(design: SensorDesign, arrays: dict[str, Array]) -> AmortizedStart:
    count = sum(name.startswith("weight") for name in arrays)
    layers = tuple(
        (arrays[f"weight{k}"].astype(np.float32), arrays[f"offset{k}"].astype(np.float32))
        for k in range(count)
    )
    rows = 1e-6 * arrays["rows"].astype(float)
    view = PressView.with_moments(
        design, arrays["moments"].astype(float), rows, float(arrays["sd"])
    )
    scale = arrays["scale"].astype(float)
    return AmortizedStart(view, Network(layers), arrays["inputs"], scale)
