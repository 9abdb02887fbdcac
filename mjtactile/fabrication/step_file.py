"""STEP files (ISO 10303-21, AP214) of a `Part`: a closed boundary of exact planes and cylinders.

A side face spans the layers with the same contour. A horizontal face closes the area in which two
neighboring layers differ. Each edge belongs to two faces, once in each direction. Each loop is
counter-clockwise seen from outside (ISO 10303-42).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np

from mjtactile.core.types import Array
from mjtactile.fabrication.layered_solid import Bore, Contour, Layer, Part

_NUDGE = 1e-4  # offset from a contour to test either side of it, mm
_X, _Y, _Z = np.eye(3)
Loop = list[tuple[int, bool]]
"""Edges, and for each whether its direction is the loop's."""


class _File:
    """Numbered lines, each written once."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self._known: dict[str, int] = {}

    def add(self, text: str) -> int:
        """Return the number of the entity `text`; a new entity is added."""
        if text not in self._known:
            self.lines.append(text)
            self._known[text] = len(self.lines)
        return self._known[text]

    def point(self, p: Array) -> int:
        return self.add(f"CARTESIAN_POINT('',({_numbers(p)}))")

    def direction(self, d: Array) -> int:
        return self.add(f"DIRECTION('',({_numbers(d)}))")

    def placement(self, origin: Array, axis: Array, along: Array) -> int:
        entities = [self.point(origin), self.direction(axis), self.direction(along)]
        return self.add(f"AXIS2_PLACEMENT_3D('',{_references(entities)})")

    def _edge(self, start: Array, end: Array, curve: int) -> int:
        first, second = (self.add(f"VERTEX_POINT('',#{self.point(p)})") for p in (start, end))
        return self.add(f"EDGE_CURVE('',#{first},#{second},#{curve},.T.)")

    def line(self, start: Array, end: Array) -> int:
        """Add a straight edge."""
        length = float(np.linalg.norm(end - start))
        vector = self.add(f"VECTOR('',#{self.direction((end - start) / length)},1.)")
        return self._edge(start, end, self.add(f"LINE('',#{self.point(start)},#{vector})"))

    def arc(self, start: Array, end: Array, centre: Array, axis: Array, along: Array) -> int:
        """Add an edge along a circle, counter-clockwise about `axis`."""
        radius = _number(float(np.linalg.norm(start - centre)))
        curve = self.add(f"CIRCLE('',#{self.placement(centre, axis, along)},{radius})")
        return self._edge(start, end, curve)

    def face(self, surface: int, loops: Sequence[Loop], *, same_sense: bool = True) -> int:
        """Add a face; the first of `loops` is its outer bound."""
        bounds = []
        for index, loop in enumerate(loops):
            edges = [
                self.add(f"ORIENTED_EDGE('',*,*,#{e},{_flag(forward)})") for e, forward in loop
            ]
            closed = self.add(f"EDGE_LOOP('',({_references(edges)}))")
            kind = "FACE_BOUND" if index else "FACE_OUTER_BOUND"
            bounds.append(self.add(f"{kind}('',#{closed},.T.)"))
        return self.add(f"ADVANCED_FACE('',({_references(bounds)}),#{surface},{_flag(same_sense)})")

    def plane(self, origin: Array, normal: Array, along: Array) -> int:
        return self.add(f"PLANE('',#{self.placement(origin, normal, along)})")

    def cylinder(self, centre: Array, axis: Array, along: Array, radius: float) -> int:
        axes = self.placement(centre, axis, along)
        return self.add(f"CYLINDRICAL_SURFACE('',#{axes},{_number(radius)})")


def write_step(part: Part) -> str:
    """Return the text of a STEP file of `part`, in mm."""
    file = _File()
    faces = [*_sides(file, part), *_levels(file, part)]
    if part.bore:
        faces += _bore_faces(file, part.bore)
    shell = file.add(f"CLOSED_SHELL('',({_references(faces)}))")
    solid = file.add(f"MANIFOLD_SOLID_BREP('{part.name}',#{shell})")
    _product(file, part.name, solid)
    body = "\n".join(f"#{number}={line};" for number, line in enumerate(file.lines, 1))
    return (
        f"ISO-10303-21;\nHEADER;\nFILE_DESCRIPTION(('{part.name}'),'2;1');\n"
        f"FILE_NAME('{part.name}.step','',(''),(''),'mjtactile','mjtactile','');\n"
        "FILE_SCHEMA(('AUTOMOTIVE_DESIGN { 1 0 10303 214 1 1 1 1 }'));\nENDSEC;\nDATA;\n"
        f"{body}\nENDSEC;\nEND-ISO-10303-21;\n"
    )


def _spans(part: Part) -> list[tuple[Contour, bool, float, float]]:
    """Return each side wall: contour, True for an outer wall, lower and upper height."""
    open_walls: dict[tuple[Contour, bool], float] = {}
    spans = []
    for layer in part.layers:
        here = _roles(layer)
        for key in [key for key in open_walls if key not in here]:
            spans.append((*key, open_walls.pop(key), layer.low))
        for key in here:
            open_walls.setdefault(key, layer.low)
    return spans + [(*key, low, part.high) for key, low in open_walls.items()]


def _roles(layer: Layer | None) -> dict[tuple[Contour, bool], None]:
    """Return the contours of a layer in order, with True for outer ones."""
    regions = layer.regions if layer is not None else ()
    return dict.fromkeys(
        (contour, contour is region.outer)
        for region in regions
        for contour in (region.outer, *region.holes)
    )


def _ring(file: _File, contour: Contour, z: float) -> list[int]:
    """Return the edges of a contour at a height, counter-clockwise."""
    return [
        file.line(np.append(start, z), np.append(end, z))
        if centre is None
        else file.arc(np.append(start, z), np.append(end, z), np.append(centre, z), _Z, _X)
        for start, end, centre in contour.edges()
    ]


def _sides(file: _File, part: Part) -> Iterable[int]:
    """Yield the faces of the walls: a plane or part of a cylinder for each edge of a contour."""
    for contour, outer, low, high in _spans(part):
        bottom = _ring(file, contour, low)
        top = _ring(file, contour, high)
        for k, (p, q, centre) in enumerate(contour.edges()):
            rise_p = file.line(np.append(p, low), np.append(p, high))
            rise_q = file.line(np.append(q, low), np.append(q, high))
            loop = [(bottom[k], True), (rise_q, True), (top[k], False), (rise_p, False)]
            if not outer:
                loop = [(edge, not forward) for edge, forward in reversed(loop)]
            if centre is not None:
                round_wall = file.cylinder(np.append(centre, low), _Z, _X, contour.r)
                yield file.face(round_wall, [loop], same_sense=outer)
                continue
            along = np.append(q - p, 0) / np.linalg.norm(q - p)
            normal = np.cross(along, _Z) * (1 if outer else -1)
            bore = part.bore
            if bore is not None and not (low < bore.z < high and _spans_bore(bore, p, q)):
                bore = None
            mouths = _mouths(file, bore, contour, normal, outer=outer)
            yield file.face(file.plane(np.append(p, low), normal, along), [loop, *mouths])


def _spans_bore(bore: Bore, p: Array, q: Array) -> bool:
    """Return True if a wall from `p` to `q` contains the full width of the bore."""
    low, high = sorted((p[1], q[1]))
    return low < bore.y - bore.radius and bore.y + bore.radius < high


def _levels(file: _File, part: Part) -> Iterable[int]:
    """Yield the horizontal faces where only one of two neighboring layers has material."""
    for under, over in pairwise([None, *part.layers, None]):
        z = over.low if over is not None else part.high
        for solid, free, up in ((under, over, True), (over, under, False)):
            for outer, holes in _differences(solid, free):
                loops = [_level_loop(file, outer, z, forward=up)]
                loops += [_level_loop(file, hole, z, forward=not up) for hole in holes]
                normal = _Z if up else -_Z
                yield file.face(file.plane(np.array([0, 0, z]), normal, _X), loops)


def _level_loop(file: _File, contour: Contour, z: float, *, forward: bool) -> Loop:
    ring = _ring(file, contour, z)
    if forward:
        return [(edge, True) for edge in ring]
    return [(edge, False) for edge in reversed(ring)]


def _differences(solid: Layer | None, free: Layer | None) -> list[tuple[Contour, list[Contour]]]:
    """Return outer contour and holes of each area inside `solid` and outside `free`."""
    if solid is None:
        return []
    mine = _roles(solid)
    theirs = _roles(free)
    only_mine = [key for key in mine if key not in theirs]
    only_theirs = [key for key in theirs if key not in mine]
    bounds = dict.fromkeys(contour for contour, _ in only_mine + only_theirs)

    def covered(contour: Contour, inward: float) -> bool:
        x, y = contour.east
        x -= inward
        return solid.holds(x, y) and not (free is not None and free.holds(x, y))

    sides = {contour: (covered(contour, _NUDGE), covered(contour, -_NUDGE)) for contour in bounds}
    outers = [contour for contour, (inside, outside) in sides.items() if inside and not outside]
    faces: dict[Contour, list[Contour]] = {outer: [] for outer in outers}
    holes = [contour for contour, (inside, outside) in sides.items() if outside and not inside]
    for hole in holes:
        around = [outer for outer in outers if outer.distance(*hole.east) < 0]
        faces[min(around, key=lambda outer: outer.area)].append(hole)
    return list(faces.items())


def _mouths(
    file: _File, bore: Bore | None, contour: Contour, normal: Array, *, outer: bool
) -> list[Loop]:
    """Return the bounds of a bore in a face on the +x side of a contour, if it ends there."""
    if bore is None or contour != (bore.outer if outer else bore.inner):
        return []
    towards_x = normal[0] if outer else -normal[0]
    if towards_x < 0.5:
        return []
    start, end = bore.ends
    first, second = _bore_ring(file, bore, end if outer else start)
    if outer:
        return [[(second, False), (first, False)]]
    return [[(first, True), (second, True)]]


def _bore_points(bore: Bore, x: float) -> tuple[Array, Array, Array]:
    """Return the center of an end of the bore, and the start points of its two seams."""
    centre = np.array([x, bore.y, bore.z])
    return centre, centre + bore.radius * _Y, centre - bore.radius * _Y


def _bore_ring(file: _File, bore: Bore, x: float) -> list[int]:
    centre, east, west = _bore_points(bore, x)
    return [file.arc(east, west, centre, _X, _Y), file.arc(west, east, centre, _X, _Y)]


def _bore_faces(file: _File, bore: Bore) -> list[int]:
    """Return the bore's wall, in two halves that meet in its seams."""
    start, end = bore.ends
    near = _bore_ring(file, bore, start)
    far = _bore_ring(file, bore, end)
    _, *starts = _bore_points(bore, start)
    _, *ends = _bore_points(bore, end)
    seams = [file.line(a, b) for a, b in zip(starts, ends, strict=True)]
    surface = file.cylinder(np.array([start, bore.y, bore.z]), _X, _Y, bore.radius)
    halves = [
        [(far[k], True), (seams[1 - k], False), (near[k], False), (seams[k], True)] for k in (0, 1)
    ]
    return [file.face(surface, [loop], same_sense=False) for loop in halves]


def _product(file: _File, name: str, solid: int) -> None:
    """Add the entities that make a solid a separate product, with the unit mm."""
    add = file.add
    length = add("(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.))")
    angle = add("(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.))")
    solid_angle = add("(NAMED_UNIT(*)SI_UNIT($,.STERADIAN.)SOLID_ANGLE_UNIT())")
    accuracy = f"LENGTH_MEASURE(1.E-6),#{length},'distance_accuracy_value',''"
    close = add(f"UNCERTAINTY_MEASURE_WITH_UNIT({accuracy})")
    units = f"GLOBAL_UNIT_ASSIGNED_CONTEXT((#{length},#{angle},#{solid_angle}))"
    context = add(
        "(GEOMETRIC_REPRESENTATION_CONTEXT(3)"
        f"GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT((#{close})){units}REPRESENTATION_CONTEXT('',''))"
    )
    axes = file.placement(np.zeros(3), _Z, _X)
    shape = add(f"ADVANCED_BREP_SHAPE_REPRESENTATION('',(#{axes},#{solid}),#{context})")
    application = add("APPLICATION_CONTEXT('automotive design')")
    standard = f"'international standard','automotive_design',2000,#{application}"
    add(f"APPLICATION_PROTOCOL_DEFINITION({standard})")
    mechanical = add(f"PRODUCT_CONTEXT('',#{application},'mechanical')")
    product = add(f"PRODUCT('{name}','{name}','',(#{mechanical}))")
    add(f"PRODUCT_RELATED_PRODUCT_CATEGORY('part',$,(#{product}))")
    formation = add(f"PRODUCT_DEFINITION_FORMATION('','',#{product})")
    view = add(f"PRODUCT_DEFINITION_CONTEXT('part definition',#{application},'design')")
    definition = add(f"PRODUCT_DEFINITION('design','',#{formation},#{view})")
    meaning = add(f"PRODUCT_DEFINITION_SHAPE('','',#{definition})")
    add(f"SHAPE_DEFINITION_REPRESENTATION(#{meaning},#{shape})")


def _number(value: float) -> str:
    """Format a STEP real with a decimal point, rounded to 1e-9 mm."""
    text = f"{round(value, 9) + 0.0:.9f}".rstrip("0")
    return text if text.endswith(".") or "." in text else text + "."


def _numbers(values: Iterable[float]) -> str:
    return ",".join(_number(float(v)) for v in values)


def _references(ids: Iterable[int]) -> str:
    return ",".join(f"#{n}" for n in ids)


def _flag(value: bool) -> str:
    return ".T." if value else ".F."
