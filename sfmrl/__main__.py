"""`sfmrl` and `python -m sfmrl`: what a signal does is settled first, then all is imported that takes time."""

import signal
import sys


def main() -> None:
    """The command; SIGTERM and SIGHUP end it as Ctrl-C does, with 130 and one line, and the terminal is restored."""
    try:
        for name in ("SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)  # Windows has no SIGHUP
            if number and signal.getsignal(number) == signal.SIG_DFL:  # nohup has it ignored
                signal.signal(number, signal.default_int_handler)
        from sfmrl.cli import main as command

        command()
    except KeyboardInterrupt:
        sys.stderr.write("sfmrl: interrupted\n")
        sys.exit(130)


if __name__ == "__main__":
    main()
