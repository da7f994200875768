"""A target whose import takes long, as that of callbacks does which are compiled meanwhile."""

import time
from typing import Any

time.sleep(3.0)


def done(payload: Any, report: Any) -> Any:
    return payload
