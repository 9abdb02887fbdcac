"""Workload of a simulated rig: measured wall times, and the sizes that determine them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Workload:
    """Wall time of a simulation so far, and the present contacts.

    `physics` and `rendering` are wall times, s. `contacts` is the number of contact points with the
    membranes, `geoms` the number of other geoms near them. `elements` is the number of elements of
    soft objects, `vertices` that of the membranes' meshes (0: quasi-static membranes).
    """

    physics: float
    rendering: float
    contacts: int
    geoms: int
    elements: int
    vertices: int
