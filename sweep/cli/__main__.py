"""`python -m sweep.cli`: the command `sweep` where it is not on the PATH."""

from sweep.cli.main import main

raise SystemExit(main())
