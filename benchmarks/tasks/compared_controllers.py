"""Controllers that `mjtactile bench tasks` compares."""

CONTROLLERS = ("adaptive", "gentle", "slip_aware", "touchless")
SHOWN = (*CONTROLLERS, "oracle")
READY = "grip force relative to that with the announced push, median"
