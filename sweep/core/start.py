"""Which version this is, and when this process began to read it; `sweep` imports this before any other module."""

import os
import time

VERSION = "0.2.0"
STARTED = time.time()
# no messages of XLA's own: an alarm asks for a bug report where something compiles for two minutes; errors are raised
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
