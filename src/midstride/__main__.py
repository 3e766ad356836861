"""``python -m midstride`` is the command."""

import sys

from midstride.cli import main

sys.exit(main())
