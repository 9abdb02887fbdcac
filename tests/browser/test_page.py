"""Tests of `summary.html` in a real browser: plots, zoom, readout, rotation, and the time
slider."""

import cv2
import numpy as np
import pytest

from mjtactile.recording.decimated_history import DecimatedHistory
from mjtactile.recording.reader import load_recording
from mjtactile.report.page import write_page
from tests.browser.page import CHROMIUM, open_page
from tests.fake_run import write_fake_recording
from tests.unit.report.test_report import SUMMARY, FakeScene

pytestmark = [
    pytest.mark.browser,
    pytest.mark.clock,
    pytest.mark.xdist_group("browser"),
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here"),
]


def place(page, selector):
    """Return left, top, width, height of an element on the screen, px."""
    return page.run(
        f"document.querySelector('{selector}').scrollIntoView({{block: 'center'}});"
        f"(({{x, y, width, height}}) => [x, y, width, height])("
        f"document.querySelector('{selector}').getBoundingClientRect())"
    )


def pixels(page, selector):
    return page.run(f"document.querySelector('{selector}').toDataURL()")


def test_page_supports_zoom_readout_rotation_and_time_slider(tmp_path):
    cycles = write_fake_recording(tmp_path / "run", count=60)
    strip = DecimatedHistory()
    for cycle in cycles:
        strip.add(cycle, FakeScene(2))
    recording = load_recording(tmp_path / "run")
    path = tmp_path / "summary.html"
    write_page(path, recording, strip.kept, SUMMARY, cycles[40])
    with open_page(path.as_uri(), tmp_path / "browser") as page:
        # not the blank page before
        page.wait_for("document.readyState === 'complete' && document.title !== ''")
        x, y, width, height = place(page, "#chart")
        assert page.run("[chart.shown.from, chart.shown.to]") == pytest.approx(
            [0, 59 / 30], abs=1e-3
        )

        page.mouse("mouseMoved", x + width / 2, y + height / 2)  # readout
        i = int(page.run("lastBefore(data.time, view.pointer)"))
        force = recording.column("force_normal")[i]
        text = page.run("document.getElementById('readout').textContent")
        assert (
            f"left estimated {force[0]:.3f} ± 0.060" in text
            and f"right estimated {force[1]:.3f}" in text
        )

        # closer, about the pointer
        page.mouse("mouseWheel", x + width / 2, y + height / 2, deltaX=0, deltaY=-600)
        center, span = page.run("[(view.from + view.to) / 2, view.to - view.from]")
        # of times that are written to 0.1 ms
        assert span == pytest.approx(np.exp(-0.9) * 59 / 30, rel=1e-4)
        assert center == pytest.approx(59 / 60, abs=0.05)

        before = pixels(page, "canvas.membrane")
        x, y, width, height = place(page, "canvas.membrane")
        page.mouse("mousePressed", x + width / 2, y + height / 2)
        page.mouse("mouseMoved", x + width / 2 + 60, y + height / 2 + 20, buttons=1)
        page.mouse("mouseReleased", x + width / 2 + 60, y + height / 2 + 20)
        assert page.run("view.yaw") == pytest.approx(0.0, abs=0.02)  # -0.6 rad and 60 px of 0.01
        turned = pixels(page, "canvas.membrane")
        assert turned != before

        assert page.run("view.shot") == 20
        images = page.run("document.querySelector('img.camera').src")
        page.run(
            "(s => {s.value = 3; s.dispatchEvent(new "
            "Event('input'))})(document.getElementById('slider'))"
        )
        assert (
            page.run("document.querySelector('img.camera').src") != images
            and pixels(page, "canvas.membrane") != turned
        )
        assert (
            page.run("document.getElementById('moment').textContent") == f"{cycles[6].time:.2f} s"
        )
        cv2.imwrite(str(tmp_path / "page.png"), page.image())
        assert page.image().std() > 20
