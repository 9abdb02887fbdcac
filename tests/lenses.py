"""Cameras of each lens model, and their projection by OpenCV."""

import cv2
import numpy as np

from mjtactile.core.optics import Camera

CAMERAS = {
    camera.distortion_model: camera
    for camera in (
        Camera(640, 480, 600.0, 610.0, 320.5, 238.0, (-0.21, 0.08, 0.002, -0.003, -0.01)),
        Camera(
            *(640, 480, 600.0, 610.0, 320.5, 238.0),
            (0.5, 0.1, 2e-3, -3e-3, 0.02, 0.9, 0.2, 0.05),
            distortion_model="rational_polynomial",
        ),
        Camera(
            *(640, 480, 400.0, 410.0, 320.5, 238.0),
            (0.1, -0.02, 0.01, -0.003),
            distortion_model="equidistant",
        ),
    )
}


def opencv_pixels(camera, p_CP):
    """Return the pixels (N, 2) of points (N, 3) by OpenCV."""
    zero = np.zeros(3)
    k = np.array(camera.distortion)
    if camera.distortion_model == "equidistant":
        points = np.ascontiguousarray(p_CP[:, None])
        return cv2.fisheye.projectPoints(points, zero, zero, camera.K, k)[0][:, 0]
    return cv2.projectPoints(p_CP, zero, zero, camera.K, k)[0][:, 0]
