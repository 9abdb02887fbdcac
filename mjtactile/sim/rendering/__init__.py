"""Images of the sensor's camera: an analytic renderer with glass, lens, light and shadows."""
