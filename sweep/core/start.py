"""Which version this is, and when this process began to read it; `sweep` imports this before any other module."""

import time

VERSION = "0.1.0"
STARTED = time.time()
