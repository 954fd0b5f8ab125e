"""The version of the package and the start time of this process. `sweep` imports this module first."""

import os
import time

VERSION = "0.2.0"
PROCESS_START_S = time.time()
# silence XLA's own messages: one asks for a bug report after two minutes of compiling; errors are raised anyway
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
