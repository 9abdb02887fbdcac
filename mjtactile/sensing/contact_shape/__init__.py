"""What touches: a body of few numbers that the film meets as the markers show it
(docs/theory/contact_shape.md, Eq. F18-F20)."""
