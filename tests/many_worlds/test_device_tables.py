"""Arrays that membranes in Warp get from the host. No kernel is compiled: a smoke test."""

import numpy as np
import pytest

from mjtactile.core.design import load_sensor

pytest.importorskip("warp")
pytest.importorskip("mujoco_warp")

from mjtactile.quasistatic import QuasistaticMembrane
from mjtactile.warp.cut_cells import cut_cells
from mjtactile.warp.marker_positions import weights_of
from mjtactile.warp.stencil import plane_stencil


@pytest.mark.parametrize("name", ["dense", "round30", "ellipse"])
def test_triangles_and_whole_cells_fill_the_outline(name):
    membrane = QuasistaticMembrane(name)
    cut, nodes = cut_cells(membrane)
    whole = cut.whole.numpy().reshape(membrane.grid)[:-1, :-1].sum()
    cell = (membrane.x[1] - membrane.x[0]) * (membrane.y[1] - membrane.y[0])
    area = load_sensor(name).frame.area
    # the area between the outline and its chord in a cell is omitted: (spacing / diameter)^2
    assert whole * cell + cut.area.numpy().sum() == pytest.approx(area, rel=5e-3)
    assert (nodes > 0).sum() <= (membrane.grid[0] - 2) * (membrane.grid[1] - 2)
    first, corners = cut.first_corner.numpy(), cut.corners.numpy()[: cut.first_corner.numpy()[-1]]
    owners = np.repeat(np.arange(nodes.size), np.diff(first))
    assert (cut.nodes.numpy()[corners] == owners).all()
    assert (nodes[owners] > 0).all()


def test_the_plane_is_stiff_and_symmetric():
    stencil = plane_stencil(QuasistaticMembrane("dense"))
    for own, along_x, along_y, diagonal in (stencil[:4], stencil[4:8]):
        # a uniform shift costs no energy: neighbors balance the node
        total = own + 2 * along_x + 2 * along_y + 4 * diagonal
        assert own > 0 and total == pytest.approx(0, abs=1e-5 * own)


@pytest.mark.parametrize("name", ["dense", "round30"])
def test_markers_rest_on_their_layout(name):
    membrane = QuasistaticMembrane(name)
    rest, weights = weights_of(membrane)
    assert rest == pytest.approx(membrane.design.markers.p_SM, abs=1e-6)
    heights = weights @ membrane.rest.x[2].ravel()
    assert (heights > 0).all() and heights.max() < 1.01 * membrane.rest.x[2].max()
