"""`python -m framekit`: the command line."""

import sys

from framekit.cli.main import main

sys.exit(main())
