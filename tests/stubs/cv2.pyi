# OpenCV's own stubs type every array as the union of all numeric ones, and know no scalars as operands: noise only.
from typing import Any

def __getattr__(name: str) -> Any: ...
