"""What the sensor's camera sees: an analytic renderer with glass, lens, light and shadows."""
