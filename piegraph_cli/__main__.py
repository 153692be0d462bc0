"""The program, from its first moment on: `piegraph`, or `python -m piegraph_cli` where it is not on the PATH."""

import os
import sys

from piegraph_cli.signals import leave, obey, over, stopped


def main() -> None:
    """The `piegraph` program. A signal that comes while its modules are imported is a signal too."""
    # read when NumPy is imported: matrices are small here, and threads that wait for each other cost thrice the processor time
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        obey()
        from piegraph_cli.commands.program import run

        code = run()
        over()
    except Exception:
        if stopped() is None:
            raise
        code = _early()
    except KeyboardInterrupt:
        code = _early()
    if stopped() is not None:
        leave(code)
    sys.exit(code)


def _early() -> int:
    """Nothing was begun yet."""
    over()
    print("interrupted", file=sys.stderr)
    return 128 + (stopped() or 2)


if __name__ == "__main__":  # worker processes import this file under another name
    main()
