# MuJoCo's compiled modules have stubs that omit most attributes.
from typing import Any

def __getattr__(name: str) -> Any: ...
