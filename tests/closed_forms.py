"""Closed-form solutions that only the tests compare with."""

import numpy as np

from mjtactile.core.analytical_solutions import hencky_factor

POINT_LOAD = {0.0: 0.86098, 0.2: 0.95729, 0.3: 1.02206, 1 / 3: 1.0472, 0.4: 1.10435, 0.5: 1.21334}
"""F a^2 / (E h d^3) of a clamped circle, by Poisson ratio."""


def hencky_height(radius, stiffness, poisson, pressure):
    """Return the height, m, of a clamped circle of stiffness E h, N/m, under pressure, Pa (M2)."""
    return radius * hencky_factor(poisson) * (pressure * radius / stiffness) ** (1 / 3)


def point_load(radius, stiffness, poisson, depth):
    """Return the force, N, that indents the center of a clamped circle by `depth` m (M6)."""
    return POINT_LOAD[poisson] * stiffness * depth**3 / radius**2


def sphere_on_circle(radius, tension, sphere, force):
    """Return the indentation, m, of a sphere on a circle of constant tension, N/m (M4).

    Slopes must be small, and the contact small relative to the circle.
    """
    contact_square = force * sphere / (2 * np.pi * tension)
    return force / (2 * np.pi * tension) * (np.log(radius / np.sqrt(contact_square)) + 0.5)


def relaxed_modulus(relaxation, time):
    """Return the stress over the long-term stress after a strain step: 1 + sum a_i e^(-t/tau_i)."""
    times = np.asarray(time, float)[..., None]
    return 1.0 + (relaxation.fractions * np.exp(-times / relaxation.times)).sum(axis=-1)
