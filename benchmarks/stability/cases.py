"""The case matrix of `mjtactile bench stability`: single axes and the relevant pairs of axes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

from mjtactile.core.design import SensorDesign


@dataclass(frozen=True)
class Case:
    """One scene. SI units; `axis` and `label` are its position on the map.

    `kind`: "press" (drive `indenter` to `depth`, `shear`, `valve` step after contact), "drop" (a
    weight of `mass` at `speed` on a rail, then at rest), "rest" (a free object on the membrane),
    "pinch" (between two membranes), "hold" (a press, then `steps` more steps).
    """

    axis: str
    label: str
    kind: str = "press"
    young: float = 1e6
    thickness: float = 3e-4
    pre_stretch: float = 1.05
    friction: float = 0.9
    chamber_depth: float = 0.02
    pressure: float = 1000.0
    timestep: float = 4e-3
    mesh: tuple[int, int] = (13, 11)
    indenter: str = "sphere:8"
    depth: float = 2e-3
    at: tuple[float, float] = (0.0, 0.0)
    shear: float = 0.0
    valve: str = ""
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    shake: tuple[float, float] = (0.0, 0.0)
    body: str = "sphere"
    size: float = 0.01
    mass: float = 0.01
    speed: float = 0.0
    steps: int = 0

    def design(self, base: SensorDesign) -> SensorDesign:
        rubber = replace(
            base.membrane,
            young=self.young,
            thickness=self.thickness,
            pre_stretch=self.pre_stretch,
            friction=self.friction,
        )
        return replace(
            base, membrane=rubber, chamber=replace(base.chamber, depth=self.chamber_depth)
        )

    @property
    def pressed(self) -> float:
        """Depth of the load, m; it stays clear of the glass, unless the case tests that."""
        return self.depth if self.axis == "glass" else min(self.depth, 0.7 * self.chamber_depth)


_STEPS = (5e-4, 1e-3, 2e-3, 4e-3, 8e-3)
_YOUNG = (5e4, 1e5, 2e5, 5e5, 2e6, 5e6, 1e7, 2e7, 5e7)
_MASSES = (1e-4, 3e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1, 0.3, 1.0)
_INDENTERS = (
    "cylinder:0.5",
    "cylinder:1",
    "cylinder:2",
    "cylinder:5",
    "cylinder:10",
    "sphere:1",
    "sphere:2",
    "sphere:4",
    "sphere:15",
    "sphere:30",
    "box:3",
    "box:6",
    "box:12",
    "box:60",
)


def _young_for(young: float) -> float:
    """Return the pressure, Pa, at which a membrane of this modulus bulges like the paper's."""
    return 1000.0 * young / 1e6


def _membranes() -> Iterator[Case]:
    for young, step in product(_YOUNG, (2e-3, 4e-3, 8e-3)):
        yield Case(
            "Young's modulus",
            f"{young / 1e6:g} MPa, {step * 1e3:g} ms",
            young=young,
            timestep=step,
            pressure=_young_for(young),
        )
    for young in _YOUNG:
        yield Case("Young's modulus at 1 kPa", f"{young / 1e6:g} MPa", young=young)
    for thickness, step in product((5e-5, 1e-4, 2e-4, 5e-4, 1e-3), (2e-3, 4e-3, 8e-3)):
        yield Case(
            "thickness",
            f"{thickness * 1e3:g} mm, {step * 1e3:g} ms",
            thickness=thickness,
            timestep=step,
            pressure=1000 * thickness / 3e-4,
        )
    for stretch, pressure in product(
        (0.98, 0.99, 1.0, 1.02, 1.1, 1.2, 1.3), (200.0, 1000.0, 5000.0)
    ):
        yield Case(
            "pre-stretch",
            f"{stretch:g}, {pressure / 1e3:g} kPa",
            pre_stretch=stretch,
            pressure=pressure,
        )


def _gases() -> Iterator[Case]:
    for depth, step in product((5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 3e-2), (2e-3, 4e-3, 8e-3)):
        yield Case(
            "chamber depth",
            f"{depth * 1e3:g} mm, {step * 1e3:g} ms",
            chamber_depth=depth,
            timestep=step,
        )
    for pressure, step in product(
        (-20e3, -10e3, -5e3, -1e3, 0.0, 200.0, 2e3, 5e3, 1e4, 2e4, 5e4), (2e-3, 4e-3, 8e-3)
    ):
        yield Case(
            "pressure",
            f"{pressure / 1e3:g} kPa, {step * 1e3:g} ms",
            pressure=pressure,
            timestep=step,
        )
    for valve, step in product(
        ("open", "vent", "to 3 kPa", "puncture", "pump"), (2e-3, 4e-3, 8e-3)
    ):
        yield Case("valve in contact", f"{valve}, {step * 1e3:g} ms", valve=valve, timestep=step)


def _grids() -> Iterator[Case]:
    for mesh, step in product(((7, 7), (9, 9), (11, 9), (15, 13), (17, 15)), _STEPS[1:]):
        yield Case("mesh", f"{mesh[0]}x{mesh[1]}, {step * 1e3:g} ms", mesh=mesh, timestep=step)
    for mesh in ((21, 17), (31, 25), (41, 31)):
        yield Case("mesh", f"{mesh[0]}x{mesh[1]}, 4 ms", mesh=mesh)
    for step in _STEPS:
        yield Case("time step", f"{step * 1e3:g} ms", timestep=step)


def _shapes() -> Iterator[Case]:
    for indenter, at in product(_INDENTERS, ((0.0, 0.0), (1.1e-3, 1.2e-3))):
        yield Case(
            "indenter",
            f"{indenter}{' off the middle' if any(at) else ''}",
            indenter=indenter,
            at=at,
        )
    for depth, chamber in product((4e-3, 8e-3, 15e-3, 24e-3), (5e-3, 20e-3)):
        yield Case(
            "glass",
            f"{depth * 1e3:g} mm into {chamber * 1e3:g}",
            depth=depth,
            chamber_depth=chamber,
        )
    for friction, shear in product((0.0, 0.3, 0.6, 0.9, 1.5, 2.0), (1e-3, 3e-3, 6e-3)):
        yield Case("drag", f"mu {friction:g}, {shear * 1e3:g} mm", friction=friction, shear=shear)


def _motions() -> Iterator[Case]:
    for axis, angle in product(((1, 0, 0), (0, 1, 0), (1, 1, 1)), (0.5, 1.5708, 3.1416)):
        yield Case(
            "turned mount",
            f"{axis} {angle:.2f} rad",
            mount=(axis[0] * angle, axis[1] * angle, axis[2] * angle),
        )
    for amplitude, frequency, step in product((1e-3, 5e-3), (2.0, 10.0, 25.0), (2e-3, 4e-3)):
        yield Case(
            "shaken mount",
            f"{amplitude * 1e3:g} mm, {frequency:g} Hz, {step * 1e3:g} ms",
            shake=(amplitude, frequency),
            mount=(0.3, 0.7, 0.2),
            timestep=step,
        )


def _objects() -> Iterator[Case]:
    for mass, step in product(_MASSES, (2e-3, 4e-3, 8e-3)):
        yield Case(
            "mass on a membrane",
            f"{mass * 1e3:g} g, {step * 1e3:g} ms",
            "drop",
            mass=mass,
            timestep=step,
        )
    for mass, speed in product((1e-3, 0.01, 0.03, 0.1), (0.5, 1.0, 2.0)):
        for step in (1e-3, 4e-3):
            yield Case(
                "impact",
                f"{mass * 1e3:g} g, {speed:g} m/s, {step * 1e3:g} ms",
                "drop",
                mass=mass,
                speed=speed,
                timestep=step,
            )
    for body, mass in product(("sphere", "box", "plate", "rod"), (1e-3, 0.01, 0.05)):
        yield Case(
            "free on a membrane",
            f"{body}, {mass * 1e3:g} g",
            "rest",
            body=body,
            mass=mass,
            pressure=200.0,
            size={"sphere": 0.01, "box": 0.015, "plate": 0.002, "rod": 0.004}[body],
        )
    for size, step in product((2e-4, 5e-4, 1e-3, 3e-3), (1e-3, 2e-3, 4e-3)):
        yield Case(
            "pinched sheet",
            f"{size * 1e3:g} mm, {step * 1e3:g} ms",
            "pinch",
            body="plate",
            size=size,
            mass=2e-3,
            depth=1e-3,
            timestep=step,
        )


def matrix() -> list[Case]:
    """Return all cases, more than 300."""
    hold = Case("long hold", "a million steps", "hold", mesh=(7, 7), steps=1_000_000)
    return [*_membranes(), *_gases(), *_grids(), *_shapes(), *_motions(), *_objects(), hold]


def pruned() -> list[Case]:
    """Return the cases that the tests run.

    They are the ends of every axis, on a small mesh unless the mesh is the subject.
    """
    names = {
        "0.05 MPa, 4 ms",
        "50 MPa, 4 ms",
        "0.05 mm, 4 ms",
        "1 mm, 4 ms",
        "0.98, 1 kPa",
        "1.3, 1 kPa",
        "0.5 mm, 4 ms",
        "30 mm, 4 ms",
        "-20 kPa, 4 ms",
        "50 kPa, 4 ms",
        "0.5 ms",
        "8 ms",
        "puncture, 4 ms",
        "vent, 4 ms",
        "cylinder:0.5 off the middle",
        "box:60",
        "24 mm into 20",
        "mu 0, 3 mm",
        "mu 2, 3 mm",
        "5 mm, 25 Hz, 4 ms",
        "(1, 1, 1) 1.57 rad",
        "0.1 g, 4 ms",
        "1000 g, 4 ms",
        "10 g, 2 m/s, 1 ms",
        "sphere, 10 g",
    }
    inner = {  # labels that are ends on other axes
        ("thickness", "0.5 mm, 4 ms"),
        ("chamber depth", "1 mm, 4 ms"),
        ("pinched sheet", "1 mm, 4 ms"),
    }
    cases = [
        replace(c, mesh=(11, 9))
        for c in matrix()
        if c.label in names and (c.axis, c.label) not in inner
    ]
    return [*cases, Case("long hold", "2500 steps", "hold", mesh=(7, 7), steps=2500)]
