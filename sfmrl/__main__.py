"""`sfmrl` and `python -m sfmrl`: set the signal handlers before the imports that take time."""

import os
import signal
import sys

INTERRUPTED = 130


def main() -> None:
    """Run the command; SIGTERM and SIGHUP end it like Ctrl-C: one line, exit code 130, terminal restored."""
    taken = []
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)  # Windows has no SIGHUP
        if number and signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):  # nohup ignores SIGHUP
            signal.signal(number, _end_at_once)
            taken.append(number)
    from sfmrl.cli import main as command

    try:
        for number in taken:
            signal.signal(number, signal.default_int_handler)
        command()
    except (KeyboardInterrupt, RuntimeError) as error:
        # Up to 3.11, Python raises a RuntimeError from a KeyboardInterrupt that comes while a class is being made.
        if isinstance(error, RuntimeError) and not isinstance(error.__cause__, KeyboardInterrupt):
            raise
        sys.stderr.write("sfmrl: interrupted\n")
        sys.exit(INTERRUPTED)


def _end_at_once(number: int, frame: object) -> None:
    """End without an exception, which an import may swallow or wrap; before the command starts, nothing is lost."""
    try:
        os.write(2, b"sfmrl: interrupted\n")
    finally:  # also if standard error is closed
        os._exit(INTERRUPTED)


if __name__ == "__main__":
    main()
