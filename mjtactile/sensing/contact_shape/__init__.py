"""Estimation of the contact shape: parametric shape models fitted to the marker positions
(docs/theory/contact_shape.md, Eq. F18-F20)."""
