"""Scripts of the checkout that no user runs."""
