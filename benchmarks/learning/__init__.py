"""What touch at the speed of learning costs in accuracy, and how fast it is."""
