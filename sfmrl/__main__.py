"""`sfmrl` and `python -m sfmrl`: set the signal handlers before the imports that take time."""

import signal
import sys


def main() -> None:
    """Run the command; SIGTERM and SIGHUP end it like Ctrl-C: one line, exit code 130, terminal restored."""
    try:
        for name in ("SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)  # Windows has no SIGHUP
            if number and signal.getsignal(number) == signal.SIG_DFL:  # nohup ignores SIGHUP
                signal.signal(number, signal.default_int_handler)
        from sfmrl.cli import main as command

        command()
    except KeyboardInterrupt:
        sys.stderr.write("sfmrl: interrupted\n")
        sys.exit(130)


if __name__ == "__main__":
    main()
