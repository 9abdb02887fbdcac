"""What touch buys: tasks by controllers with touch, without, and one that knows the truth."""
