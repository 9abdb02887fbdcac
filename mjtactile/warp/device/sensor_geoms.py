"""Geoms of a scene next to its sensors, and their poses in the frames of the sensors."""

from __future__ import annotations

import warp as wp

from mjtactile.warp.device.obstacles import CONVEX, PLANE, Geom

wp.set_module_options({"enable_backward": False})

_DEEP = 10.0  # half-extent of a plane's solid side, m


@wp.struct
class SensorGeoms:
    """Fingers of a scene and the geoms that each may touch.

    `frames` (fingers,) are the sensors' MuJoCo bodies. `geoms` (fingers, geoms) are indices in the
    model, -1 if absent, `kinds` their kinds, `slots` the numbers of their bodies among `bodies`
    (fingers, slots), 0 for the world. `mesh` (1 or worlds, geoms of the model) is the mesh of a
    geom, `first` and `count` (meshes,) its planes. `rbound` m and `box` are its bounding sphere and
    box. `radius` m is that of a membrane; `middle` and `half` m are center and half-extents of the
    chamber with its bulge. `outputs` (fingers, 3) are the addresses of wrench, pressure and
    touching in `sensordata`, -1 if absent.
    """

    frames: wp.array(dtype=int)
    geoms: wp.array2d(dtype=int)
    kinds: wp.array2d(dtype=int)
    mesh: wp.array2d(dtype=int)
    first: wp.array(dtype=int)
    count: wp.array(dtype=int)
    slots: wp.array2d(dtype=int)
    bodies: wp.array2d(dtype=int)
    rbound: wp.array2d(dtype=float)
    box: wp.array3d(dtype=wp.vec3)
    outputs: wp.array2d(dtype=int)
    radius: float
    middle: wp.vec3
    half: wp.vec3


@wp.func
def _is_near(
    sensor_geoms: SensorGeoms, world: int, finger: int, k: int, g: int, at: wp.vec3, R: wp.mat33
) -> bool:
    """Return True if a geom at a pose in S may touch the membrane.

    Planes and walls that are fixed to the world have large bounding spheres.
    """
    reach = sensor_geoms.radius
    near = reach + sensor_geoms.rbound[world % sensor_geoms.rbound.shape[0], g]
    if sensor_geoms.kinds[finger, k] == PLANE:
        return _beyond(sensor_geoms, at, R, 2, -_DEEP, _DEEP) < 0.0
    found = wp.dot(at, at) < near * near
    if found and sensor_geoms.bodies[finger, sensor_geoms.slots[finger, k]] == 0:
        row = world % sensor_geoms.box.shape[0]
        middle = sensor_geoms.box[row, g, 0]
        half = sensor_geoms.box[row, g, 1]
        for axis in range(3):
            if _beyond(sensor_geoms, at, R, axis, middle[axis], half[axis]) > 0.0:
                found = False
    return found


@wp.func
def _beyond(
    sensor_geoms: SensorGeoms, at: wp.vec3, R: wp.mat33, axis: int, middle: float, half: float
) -> float:
    """Return the distance between the chamber with its bulge and a geom's bounding box along an
    axis of the geom, m."""
    normal = wp.vec3(R[0, axis], R[1, axis], R[2, axis])
    offset = wp.dot(normal, sensor_geoms.middle - at) - middle
    size = wp.dot(
        wp.vec3(wp.abs(normal[0]), wp.abs(normal[1]), wp.abs(normal[2])), sensor_geoms.half
    )
    return wp.abs(offset) - size - half


@wp.func
def place_geom(
    sensor_geoms: SensorGeoms,
    geoms: wp.array2d(dtype=Geom),
    size: wp.array2d(dtype=wp.vec3),
    geom_xpos: wp.array2d(dtype=wp.vec3),
    geom_xmat: wp.array2d(dtype=wp.mat33),
    f: int,
    world: int,
    finger: int,
    k: int,
    R: wp.mat33,
    p: wp.vec3,
) -> None:
    """Write one geom's pose in the sensor's frame; kind -1 if it is out of reach."""
    g = sensor_geoms.geoms[finger, k]
    geom = Geom()
    geom.kind = -1
    if g >= 0:
        at = wp.transpose(R) @ (geom_xpos[world, g] - p)
        R_SG = wp.transpose(R) @ geom_xmat[world, g]
        if _is_near(sensor_geoms, world, finger, k, g, at, R_SG):
            geom.kind = sensor_geoms.kinds[finger, k]
            geom.size = size[world % size.shape[0], g]
            geom.p = at
            geom.R = R_SG
            mesh = sensor_geoms.mesh[world % sensor_geoms.mesh.shape[0], g]
            if geom.kind == CONVEX:
                if mesh < 0:
                    geom.kind = -1
                else:
                    geom.first = sensor_geoms.first[mesh]
                    geom.count = sensor_geoms.count[mesh]
    geoms[f, k] = geom
