"""Tests of detection on supersampled images that share no code with the detector; difficult images
are accurate or flagged."""

import cv2
import numpy as np
import pytest

from benchmarks.paper import marker_accuracy, marker_scenes
from mjtactile.core import optics
from mjtactile.sensing.image import edge_fit, ellipse, fit_validation, markers
from mjtactile.sensing.pose.circles import estimate_poses
from mjtactile.sensing.pose.neighbor_smoothing import smooth_aspect_ratio

CAMERA = marker_accuracy.CAMERA
R = marker_accuracy.RADIUS


@pytest.fixture(scope="module")
def circles():
    return marker_scenes.random_circles(CAMERA, np.random.default_rng(5))


def noisy(exact, sd=2.0, seed=0):
    return np.clip(
        np.rint(exact + np.random.default_rng(seed).normal(0, sd, exact.shape)), 0, 255
    ).astype(np.uint8)


def errors(image, circles, camera=CAMERA, polarity="dark"):
    """Return distance (n,) m of each circle from the nearest trusted solution (inf if none is
    near), and poses."""
    poses = estimate_poses(markers.detect(image, camera, polarity=polarity), camera, R)
    _, nearer, found = marker_accuracy.match(poses, circles)
    truth = np.array([c.p_C for c in circles])
    return np.where(found, np.linalg.norm(nearer - truth, axis=1), np.inf), poses


def assert_right_or_flagged(image, circles, *, minimum, camera=CAMERA, sigmas=6.0, polarity="dark"):
    """Check that every trusted marker is a true circle within `sigmas` of its uncertainty, and that
    at least `minimum` are trusted."""
    _, poses = errors(image, circles, camera, polarity)
    truth = np.array([c.p_C for c in circles])
    ok = np.flatnonzero(poses.status == "ok")
    assert len(ok) >= minimum
    for i in ok:
        distance = np.minimum(
            np.linalg.norm(truth - poses.p_CM[i], axis=1),
            np.linalg.norm(truth - poses.p_CM_alt[i], axis=1),
        )
        # 1 um: error of rounding to 8 bit and of the renderer without noise
        assert distance.min() < sigmas * np.sqrt(np.trace(poses.cov_p[i])) + 1e-6, (
            poses.uv_px[i],
            distance.min(),
        )


@pytest.mark.slow
def test_accuracy_of_the_papers_case():
    summary, _ = marker_accuracy.paper_like(images=3)
    assert summary["missed"] == 0
    # 0.0077 over 15 images; three have half as many again by chance
    assert summary["mean_mm"] < 0.012
    assert summary["worst_mm"] < 0.06
    assert abs(summary["depth_bias_mm"]) < 3 * summary["depth_bias_sd_mm"] + 0.001
    assert summary["cramer_rao_ratio"] < 2.0
    assert 0.7 < summary["chi2_per_dof"] < 1.4  # 144 degrees of freedom: 1 +- 0.12 (1 sd)


@pytest.mark.parametrize("blur", [0.0, 0.5, 1.0, 1.5, 2.0])
def test_blur_does_not_bias_the_size(circles, blur):
    """Without noise, blur does not change the fitted size.

    Uncorrected, the bias would be sigma^2/(2a) = 0.06 px at blur 1.5, a = 20 px.
    """
    ellipses = markers.detect(marker_scenes.image(CAMERA, circles, blur_px=blur, seed=None), CAMERA)
    uv = optics.project(CAMERA, [c.p_C for c in circles])
    order = np.linalg.norm(uv[:, None] - ellipses.center_px, axis=2).argmin(axis=1)
    for circle, i in zip(circles, order, strict=True):
        rim = marker_scenes.rim_px(CAMERA, circle)
        area = 0.5 * abs(
            np.sum(rim[:, 0] * np.roll(rim[:, 1], -1) - rim[:, 1] * np.roll(rim[:, 0], -1))
        )
        # mean radius from the area, px; a tenth of the uncorrected bias at blur 1.5, and 0.005 px
        # for rounding
        assert abs(np.sqrt(np.prod(ellipses.semi_axes_px[i])) - np.sqrt(area / np.pi)) < 0.007


@pytest.mark.parametrize(("depth", "sd_bound"), [(0.04, 0.006), (0.10, 0.02), (0.20, 0.03)])
def test_ellipse_covariance_agrees_with_monte_carlo(depth, sd_bound):
    """Monte Carlo over noise: large markers (profiles) and small ones (image fit, 4.5 px)."""
    circles = marker_scenes.random_circles(
        CAMERA, np.random.default_rng(1), depth=(depth, depth), tilt_deg=(15, 30)
    )
    exact = marker_scenes.exact_image(CAMERA, circles)
    repeats = 30
    samples = []
    predicted = []
    uv = optics.project(CAMERA, [c.p_C for c in circles])
    for k in range(repeats):
        found = markers.detect(noisy(exact, seed=k), CAMERA)
        order = np.linalg.norm(uv[:, None] - found.center_px, axis=2).argmin(axis=1)
        samples.append(np.concatenate([found.center_px, found.semi_axes_px], axis=1)[order])
        predicted.append(found.cov[order][:, range(4), range(4)])
    ratio = np.var(samples, axis=0, ddof=1) / np.mean(predicted, axis=0)
    # mean of 64 variance ratios with 29 degrees of freedom each: 1 +- 0.03 by chance; the asked-for
    # honesty is 0.7-1.4
    assert 0.7 < ratio.mean() < 1.4
    assert np.sqrt(np.mean(predicted)) < sd_bound


def test_small_dots_are_unbiased():
    # 3.6 px
    circles = marker_scenes.random_circles(
        CAMERA, np.random.default_rng(2), depth=(0.24, 0.26), tilt_deg=(0, 30)
    )
    ellipses = markers.detect(marker_scenes.image(CAMERA, circles, noise_dn=0.2), CAMERA)
    uv = optics.project(CAMERA, [c.p_C for c in circles])
    order = np.linalg.norm(uv[:, None] - ellipses.center_px, axis=2).argmin(axis=1)
    for circle, i in zip(circles, order, strict=True):
        rim = marker_scenes.rim_px(CAMERA, circle)
        area = 0.5 * abs(
            np.sum(rim[:, 0] * np.roll(rim[:, 1], -1) - rim[:, 1] * np.roll(rim[:, 0], -1))
        )
        if ellipses.status[i] == "ok":
            # a first-order correction would be wrong by 0.02 px here
            assert abs(np.sqrt(np.prod(ellipses.semi_axes_px[i])) - np.sqrt(area / np.pi)) < 0.012
    assert (ellipses.status == "ok").sum() >= 14


def glare(exact, circles, every, extent):
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    image = exact.copy()
    for circle in circles[::every]:
        p = optics.project(CAMERA, circle.p_C)
        image += 300 * np.exp(-((u - p[0] - 15) ** 2 + (v - p[1] - 5) ** 2) / (2 * extent**2))
    return image


HARD = {
    "dark": (lambda e, c: marker_scenes.exact_image(CAMERA, c, dark_dn=8, bright_dn=40), 16),
    "low contrast": (
        lambda e, c: marker_scenes.exact_image(CAMERA, c, dark_dn=100, bright_dn=115),
        14,
    ),
    "hopeless contrast": (
        lambda e, c: marker_scenes.exact_image(CAMERA, c, dark_dn=100, bright_dn=101),
        0,
    ),
    "blurred": (lambda e, c: marker_scenes.exact_image(CAMERA, c, blur_px=2), 14),
    "vignetting": (
        lambda e, c: (
            e * (1 - 0.7 * np.hypot(*(np.mgrid[:480, :640] - [[[240]], [[320]]]) / 400.0) ** 2)
        ),
        14,
    ),
    "light from one side": (lambda e, c: e * np.linspace(0.3, 1, 640), 14),
    "glare": (lambda e, c: glare(e, c, 3, 6), 8),
    "large glare": (lambda e, c: glare(e, c, 2, 14), 6),
    "motion 5 px": (lambda e, c: cv2.blur(e, (5, 1)), 0),
    "motion 9 px": (lambda e, c: cv2.blur(e, (9, 1)), 0),
    "motion 15 px": (lambda e, c: cv2.blur(e, (15, 1)), 0),
}


@pytest.mark.parametrize("name", HARD)
def test_uneven_light(circles, name):
    make, minimum = HARD[name]
    exact = marker_scenes.exact_image(CAMERA, circles)
    assert_right_or_flagged(noisy(make(exact, circles)), circles, minimum=minimum)


def test_strong_noise(circles):
    assert_right_or_flagged(
        noisy(marker_scenes.exact_image(CAMERA, circles), 15), circles, minimum=14
    )


def test_specks_and_scratches(circles):
    """Specks are small discs, so that they may be found; they must not disturb the markers
    silently."""
    exact = marker_scenes.exact_image(CAMERA, circles)
    rng = np.random.default_rng(2)
    for _ in range(150):
        cv2.circle(
            exact,
            rng.integers(0, 480, 2).tolist(),
            int(rng.integers(1, 4)),
            float(rng.choice([20, 230])),
            -1,
        )
    for _ in range(15):
        cv2.line(
            exact,
            rng.integers(0, 480, 2).tolist(),
            rng.integers(0, 480, 2).tolist(),
            float(rng.choice([30, 240])),
            1,
        )
    _, poses = errors(noisy(exact), circles)
    truth = np.array([c.p_C for c in circles])
    uv = optics.project(CAMERA, truth)
    far = np.linalg.norm(uv[:, None] - poses.uv_px, axis=2)
    # a speck of 4 px appears to be farther away
    size = np.linalg.norm(poses.p_CM, axis=1) < 0.08
    found = 0
    for i, j in zip(*np.nonzero((far < 10) & size & (poses.status == "ok")), strict=True):
        error = min(
            np.linalg.norm(poses.p_CM[j] - truth[i]), np.linalg.norm(poses.p_CM_alt[j] - truth[i])
        )
        # a speck on the edge is a systematic error that the noise does not cover: the bound is the
        # paper's own error
        assert error < 0.39e-3
        found += 1
    assert found >= 8


@pytest.mark.parametrize(("tilt", "minimum"), [(60, 12), (75, 6)])
def test_steep_markers(tilt, minimum):
    circles = marker_scenes.random_circles(CAMERA, np.random.default_rng(5), tilt_deg=(tilt, tilt))
    assert_right_or_flagged(marker_scenes.image(CAMERA, circles), circles, minimum=minimum)


def test_six_pixel_markers():
    circles = marker_scenes.random_circles(CAMERA, np.random.default_rng(5), depth=(0.14, 0.16))
    assert_right_or_flagged(marker_scenes.image(CAMERA, circles), circles, minimum=14)


def test_large_markers_are_found_at_half_the_resolution(circles):
    """A search at half the resolution finds the same large markers.

    The start of the search must not change the fit beyond a part of its uncertainty. The smallest
    marker here has 9 px.
    """
    image = noisy(marker_scenes.exact_image(CAMERA, circles))
    complete = markers.detect(image, CAMERA)
    half = markers.detect(image, CAMERA, min_radius_px=6.0)
    order = np.linalg.norm(complete.center_px[:, None] - half.center_px, axis=2).argmin(axis=1)
    assert len(half) == len(complete) == len(circles)
    assert (half.status == "ok").all()
    sd = np.sqrt(np.diagonal(complete.cov, axis1=1, axis2=2))[:, :4]
    moved = np.hstack(
        [
            half.center_px[order] - complete.center_px,
            half.semi_axes_px[order] - complete.semi_axes_px,
        ]
    )
    assert np.abs(moved / sd).max() < 0.5


def test_touching_and_cut_markers_are_flagged():
    def row(pixels):
        rays = optics.unproject(CAMERA, np.array(pixels, float))
        return [
            marker_scenes.Circle(ray / ray[2] * 0.045, np.array([0.0, 0.0, -1.0]), R)
            for ray in rays
        ]

    touching = row([(200, 240), (240, 240), (281, 240), (322.5, 240), (450, 240)])
    assert_right_or_flagged(marker_scenes.image(CAMERA, touching), touching, minimum=1)
    cut = row([(5, 100), (320, 470), (630, 240), (320, 5), (320, 240), (21.5, 300), (618, 400)])
    _, poses = errors(marker_scenes.image(CAMERA, cut), cut)
    inside = (poses.status == "ok") & (np.abs(poses.uv_px - [320, 240]).max(axis=1) > 100)
    assert not inside.any()
    assert (poses.status == fit_validation.CUT).sum() >= 3


def test_an_empty_image_has_no_markers():
    blank = np.full((480, 640), 128, np.uint8)
    assert len(markers.detect(blank, CAMERA)) == 0
    assert len(estimate_poses(markers.detect(blank, CAMERA), CAMERA, R)) == 0
    for sd in (2, 30):
        ellipses = markers.detect(noisy(np.full((480, 640), 128.0), sd), CAMERA)
        assert not (ellipses.status == "ok").any()


def test_bright_markers_are_inverted_dark_markers(circles):
    image = marker_scenes.image(CAMERA, circles)
    dark = markers.detect(image)
    bright = markers.detect(255 - image, polarity="bright")
    # float32 sums in another order
    np.testing.assert_allclose(bright.center_px, dark.center_px, atol=1e-3)


def test_colour_and_16_bit_images(circles):
    image = marker_scenes.image(CAMERA, circles)
    grey = markers.detect(image)
    for other in (
        np.repeat(image[..., None], 3, axis=2),
        image[..., None],
        image.astype(np.uint16) * 200,
    ):
        found = markers.detect(other)
        assert len(found) == len(grey)
        order = np.linalg.norm(grey.center_px[:, None] - found.center_px, axis=2).argmin(axis=1)
        np.testing.assert_allclose(found.center_px[order], grey.center_px, atol=2e-3)


@pytest.mark.slow
def test_4k_image():
    camera = optics.Camera(3840, 2160, 3000.0, 3000.0, 1919.5, 1079.5)
    circles = marker_scenes.random_circles(
        camera, np.random.default_rng(1), rows=2, columns=3, depth=(0.05, 0.06)
    )
    image = marker_scenes.image(camera, circles, noise_dn=4, blur_px=1.5)
    assert_right_or_flagged(image, circles, minimum=6, camera=camera)


@pytest.mark.parametrize(
    "camera",
    [
        optics.Camera(640, 480, 600.0, 600.0, 319.5, 239.5, (-0.3, 0.1, 0.001, -0.002, 0.0)),
        optics.Camera(
            640, 480, 600.0, 600.0, 319.5, 239.5, (-0.05, 0.01, 0.0, 0.0, 0.0), 0.002, 1.52, 0.023
        ),
    ],
    ids=["lens", "glass"],
)
def test_lens_and_glass(camera):
    circles = marker_scenes.random_circles(camera, np.random.default_rng(5))
    error, _ = errors(marker_scenes.image(camera, circles), circles, camera)
    assert error.max() < 0.06e-3  # as without: the noise's worst of 16


def test_image_fit_and_profiles_agree(circles):
    """Profiles and the fit to the image differ by less than their noise."""
    image = marker_scenes.image(CAMERA, circles)
    found = markers.detect(image)
    fit = edge_fit.fit(
        image, found.center_px, ellipse.shape_from_axes(found.semi_axes_px, found.angle)
    )
    assert np.abs(fit.center - found.center_px).max() < 0.02
    assert np.abs(ellipse.axes_from_shape(fit.shape)[0] - found.semi_axes_px).max() < 0.02


def test_neighbours_share_elongation_on_a_plane_only():
    """A tilted board of 60 dots gets flatter; circles that tilt each its own way are left alone."""
    n = np.array([0.35, 0.2, -1.0]) / np.linalg.norm([0.35, 0.2, -1.0])
    x, y = (c.ravel() * 0.006 for c in np.meshgrid(np.arange(-5, 5), np.arange(-3, 3)))
    p = np.stack([x, y, 0.12 - (n[0] * x + n[1] * y) / n[2]], axis=1)
    board = [marker_scenes.Circle(point, n, R) for point in p]
    exact = marker_scenes.exact_image(CAMERA, board)
    before = []
    after = []
    ratio = []
    for seed in range(4):
        alone = markers.detect(noisy(exact, 4, seed), CAMERA)
        shared = smooth_aspect_ratio(alone)
        assert shared is not alone
        for ellipses, errors_z in ((alone, before), (shared, after)):
            poses = estimate_poses(ellipses, CAMERA, R)
            which, nearer, found = marker_accuracy.match(poses, board)
            errors_z.append((nearer - p)[found, 2])
        ratio.append(after[-1] / np.sqrt(poses.cov_p[which[found], 2, 2]))
    # the elongation is two thirds of the variance, less a tenth for the field's own: 0.63 of the
    # sd; 240 dots: +- 0.04
    assert np.std(np.concatenate(after)) < 0.8 * np.std(np.concatenate(before))
    assert 0.7 < np.std(np.concatenate(ratio)) < 1.4

    scattered = marker_scenes.random_circles(
        CAMERA, np.random.default_rng(0), rows=7, columns=9, radius=0.001
    )
    ellipses = markers.detect(marker_scenes.image(CAMERA, scattered), CAMERA)
    assert smooth_aspect_ratio(ellipses) is ellipses
