"""Sponge on a linear drive, as in the paper."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco

from mjtactile.sim.scenes.indentation import Indenter


@dataclass(frozen=True)
class Pad(Indenter):
    """A round pad of radius `size` m with a compliant face, such as a sponge.

    The force is F = `stiffness` d + `stiffening` d^2, in N/m and N/m^2.
    """

    stiffness: float = 300.0
    stiffening: float = 0.0

    def add_to(self, spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
        """Add a rod, the geom "indenter", on a spring along the drive's axis."""
        body.mass = 0.2
        body.inertia = [1e-4] * 3
        body.explicitinertial = True
        face = body.add_body(name="face", gravcomp=1.0)
        face.add_joint(
            name="face",
            type=mujoco.mjtJoint.mjJNT_SLIDE,
            axis=[0, 0, 1],
            range=[-1e-4, 0.05],
            limited=True,
            stiffness=[self.stiffness, self.stiffening, 0.0],
            damping=[4.0, 0.0, 0.0],
        )
        face.add_geom(
            name="indenter",
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            size=[self.size, 0.01, 0],
            mass=0.02,
            rgba=[0.9, 0.75, 0.5, 1.0],
        )
