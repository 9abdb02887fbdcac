"""What touches: a body of few numbers that the film meets as the markers show it
(docs/theory/equations.md, Eq. F18-F20)."""
