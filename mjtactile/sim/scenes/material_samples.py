"""Test objects with a known material, written as MJCF files.

The format is that of docs/reference/object_files.md. A soft `MaterialSample` is lumped: two rigid
plates (its faces) on slides along x. The elements of a rheological model connect each plate to the
center.

A block of modulus E squeezed between two flat faces acts as a spring. With the area A of a face, K
= E A / L. Here the spring is specified directly, so that the ground truth is exact. Left out:
lateral bulging, stress variation over the face, waves. The force between the faces and the response
of their distance are those of the model.

    elastic        plate --[k, stiffening]-- center
                   sponge, rubber
    viscoelastic   the same, in parallel with --[k_arm]--(dashpot)-- center
                   memory foam, gel (standard linear solid)
    plastic        plate --[k]--(dry friction: yield)-- center
                   clay, granular bag; with a dashpot: dough, paste
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

PLATE = 1e-3  # half the thickness of a plate, m
# kg
_PLATE_MASS = 1e-3
_ARM_MASS = 5e-4
_CORE_MASS = 8e-3
# damping, N s/m: settles a plate in a few ms, and adds 4 mN at a finger's closing speed
_PLATE_DAMPING = 1.0
_FREE_PLAY = 1e-4  # outward play of a plate from its initial position, m
_STAND = 0.020  # height of the stand, m: the sensors' frames stay clear of the table

Kind = Literal["rigid", "elastic", "viscoelastic", "plastic"]
CLASSES = {"rigid": "solid", "elastic": "soft", "viscoelastic": "soft", "plastic": "amorphous"}


@dataclass(frozen=True)
class MaterialSample:
    """Block of `length` (x, between the fingers), `width` (y) and `height` (z), m.

    Values refer to the whole block, face to face: F = K d + B d^2 with the relaxed `stiffness` N/m
    and `stiffening` N/m^2. A viscoelastic block has a Maxwell arm of `arm_stiffness` N/m and
    `relaxation_time` s. Plastic flow has `yield_force` N and `viscosity` N s/m.
    """

    kind: Kind
    length: float = 0.024
    width: float = 0.018
    height: float = 0.016
    stiffness: float = 0.0
    stiffening: float = 0.0
    arm_stiffness: float = 0.0
    relaxation_time: float = 0.0
    yield_force: float = 0.0
    viscosity: float = 0.0
    shape: str = "box"
    break_force: float = 5.0

    @property
    def material(self) -> str:
        """The class that a probe should find."""
        return CLASSES[self.kind]

    @property
    def area(self) -> float:
        """Area of a face, m^2."""
        return self.width * self.height

    def secant_stiffness(self, force: float) -> float:
        """Return F / d of the whole block at rest under `force` N, with a relaxed arm, N/m."""
        if self.stiffening <= 0:
            return self.stiffness
        root = (self.stiffness**2 + 4 * self.stiffening * force) ** 0.5
        return 2 * self.stiffening * force / (root - self.stiffness)

    def modulus(self, force: float) -> float:
        """Return the modulus E = K L / A at this force, Pa."""
        return self.secant_stiffness(force) * self.length / self.area


def to_mjcf(sample: MaterialSample, name: str, comment: str = "") -> str:
    """Return the object's MJCF file, with the ground truth in <custom>."""
    s = sample
    numerics = {"break_force_N": s.break_force, "rotation_deg": 2.0}
    if s.kind != "rigid":
        numerics |= {
            "true_stiffness_N_m": s.stiffness,
            "true_stiffening_N_m2": s.stiffening,
            "true_face_mm2": 1e6 * s.area,
            "true_length_mm": 1e3 * s.length,
            "true_relaxation_time_s": s.relaxation_time,
            "true_yield_force_N": s.yield_force,
        }
    custom = "\n".join(
        f'    <numeric name="{key}" data="{value:.6g}"/>' for key, value in numerics.items()
    )
    parts, tendons = _rigid(s) if s.kind == "rigid" else _halves(s)
    # foot and stand stay clear of membranes that compress the object
    foot = s.height / 2 + 0.002
    slim = 0.2 * s.length
    return f"""<!-- {comment or name}
     Units: m, kg, N, s. Lumped model, made by mjtactile.sim.scenes.material_samples;
     docs/reference/object_files.md says what it stands for. -->
<mujoco model="{name}">
  <custom>
{custom}
    <text name="material" data="{s.material}"/>
  </custom>
  <worldbody>
    <body name="stand">
      <geom name="stand" type="cylinder" pos="0 0 {_STAND / 2:.6g}"
            size="{slim:.6g} {_STAND / 2:.6g}"
            friction="0.3 0.005 0.0001" rgba="0.6 0.6 0.65 1"/>
    </body>
    <body name="object" pos="0 0 {_STAND + foot:.6g}">
      <freejoint/>
      <geom name="foot" type="cylinder" pos="0 0 {-foot + 0.001:.6g}"
            size="{slim:.6g} 0.001" mass="0.002"
            friction="0.3 0.005 0.0001" conaffinity="0" rgba="0.4 0.4 0.4 1"/>
{parts}
    </body>
  </worldbody>
{tendons}</mujoco>
"""


def _rigid(s: MaterialSample) -> tuple[str, str]:
    """Return the MJCF of one geom. The height of a cylinder is along z."""
    half = (s.length / 2, s.width / 2, s.height / 2)
    size = {
        "box": f"{half[0]:.6g} {half[1]:.6g} {half[2]:.6g}",
        "cylinder": f"{half[0]:.6g} {half[2]:.6g}",
        "sphere": f"{half[0]:.6g} {half[1]:.6g} {half[2]:.6g}",
    }[s.shape]
    kind = "ellipsoid" if s.shape == "sphere" else s.shape
    return (
        f'      <geom name="body" type="{kind}" size="{size}" mass="{_CORE_MASS:g}" friction="0.3 '
        '0.005 0.0001" conaffinity="0" rgba="0.7 0.75 0.8 1"/>'
    ), ""


def _halves(s: MaterialSample) -> tuple[str, str]:
    """Return the MJCF of both halves, each twice as stiff, with four times the stiffening."""
    half_length = max(s.length / 2 - 0.006, 0.001)
    lines = [
        f'      <geom name="middle" type="box" size="{half_length:.6g} {0.8 * s.width / 2:.6g} '
        f'{0.8 * s.height / 2:.6g}" '
        f'mass="{_CORE_MASS:g}" contype="0" conaffinity="0" rgba="0.8 0.6 0.4 1"/>'
    ]
    tendons = []
    for side, sign in (("left", 1), ("right", -1)):
        if s.kind == "plastic":
            spring = ""
        else:
            spring = f'stiffness="{2 * s.stiffness:.6g} {4 * s.stiffening:.6g} 0" '
        lines += [
            f'      <body name="{side}" pos="{-sign * s.length / 2:.6g} 0 0">',
            f'        <joint name="{side}" type="slide" axis="{sign} 0 0" '
            f'{spring}damping="{_PLATE_DAMPING:g}" '
            f'range="{-_FREE_PLAY:g} {s.length / 2 - 2 * PLATE:.6g}" limited="true"/>',
            f'        <geom name="{side}" type="box" pos="{sign * PLATE:g} 0 0" size="{PLATE:g} '
            f'{s.width / 2:.6g} {s.height / 2:.6g}" mass="{_PLATE_MASS:g}" friction="0.3 0.005 '
            '0.0001" conaffinity="0" rgba="0.9 0.75 0.5 1"/>',
            "      </body>",
        ]
        if s.kind in ("viscoelastic", "plastic"):
            lines += _arm(s, side, sign)
            stiffness = s.arm_stiffness if s.kind == "viscoelastic" else s.stiffness
            tendons.append(
                f'    <fixed name="{side}_arm" stiffness="{2 * stiffness:.6g}" springlength="0" '
                f'damping="0.5"><joint joint="{side}" coef="1"/><joint joint="{side}_arm" '
                'coef="-1"/></fixed>'
            )
    if not tendons:
        return "\n".join(lines), ""
    return "\n".join(lines), "\n".join(["  <tendon>", *tendons, "  </tendon>\n"])


def _arm(s: MaterialSample, side: str, sign: int) -> list[str]:
    """Return the inner MuJoCo body, connected to the center by a dashpot or dry friction."""
    if s.kind == "viscoelastic":
        hold = f'damping="{2 * s.arm_stiffness * s.relaxation_time:.6g}"'
    else:
        hold = (
            f'damping="{2 * s.viscosity:.6g}" frictionloss="{s.yield_force:.6g}" '
            'armature="0.02" solimpfriction="0.9999 0.9999 0.001 0.5 2"'
        )
    return [
        f'      <body name="{side}_arm" pos="{-sign * s.length / 2:.6g} 0 0">',
        f'        <joint name="{side}_arm" type="slide" axis="{sign} 0 0" {hold}/>',
        f'        <inertial pos="0 0 0" mass="{_ARM_MASS:g}" diaginertia="1e-8 1e-8 1e-8"/>',
        "      </body>",
    ]


SHIPPED: dict[str, tuple[MaterialSample, str]] = {
    "block": (MaterialSample("rigid"), "A rigid block (12 g) on a low stand."),
    "rod": (
        MaterialSample("rigid", length=0.02, width=0.02, height=0.028, shape="cylinder"),
        "An upright rigid rod.",
    ),
    "pebble": (
        MaterialSample("rigid", length=0.024, width=0.03, height=0.02, shape="sphere"),
        "A rigid, rounded pebble.",
    ),
    "foam": (
        MaterialSample("elastic", stiffness=200.0),
        "Soft open foam, E = 17 kPa: 1 mm for 0.2 N.",
    ),
    "sponge": (
        MaterialSample("elastic", stiffness=300.0, stiffening=1e5),
        "A sponge that stiffens as its cells close, E = 25 kPa at rest.",
    ),
    "sponge_firm": (
        MaterialSample("elastic", stiffness=1200.0, stiffening=2e5),
        "A firm sponge, E = 100 kPa at rest.",
    ),
    "eraser": (
        MaterialSample("elastic", stiffness=4000.0),
        "A rubber eraser, E = 0.33 MPa: 0.25 mm for 1 N.",
    ),
    "memory_foam": (
        MaterialSample("viscoelastic", stiffness=250.0, arm_stiffness=450.0, relaxation_time=0.4),
        "Visco-elastic foam: gives way slowly and comes back slowly (standard "
        "linear solid, 0.4 s).",
    ),
    "clay": (
        MaterialSample("plastic", stiffness=2500.0, yield_force=0.45, viscosity=40.0),
        "Clay: yields at 0.45 N and keeps its set.",
    ),
    "dough": (
        MaterialSample("plastic", stiffness=1200.0, yield_force=0.15, viscosity=200.0),
        "Dough: flows slowly above 0.15 N and keeps its set.",
    ),
    "paste": (
        MaterialSample("plastic", stiffness=1500.0, yield_force=0.03, viscosity=100.0),
        "A tube of paste: flows under almost any force and stays as it was left.",
    ),
    "bean_bag": (
        MaterialSample("plastic", stiffness=900.0, yield_force=0.3, viscosity=10.0),
        "A bag of grains: rearranges above 0.3 N, nearly at once, and keeps its set.",
    ),
}
"""The probing objects that ship in models/objects, with the sentence that heads their file."""
