"""When this process began to read the package; `sweep` imports it before any other module."""

import time

STARTED = time.time()
