"""Who is compared in `mjtactile bench tasks`."""

CONTROLLERS = ("adaptive", "gentle", "slip_aware", "touchless")
SHOWN = (*CONTROLLERS, "oracle")
READY = "grip over what holds against the push that was announced, too, median"
