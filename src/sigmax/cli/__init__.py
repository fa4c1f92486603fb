"""The command line. Nothing but its ends stands here: a signal is heard before anything slow is loaded."""

import sys

from sigmax.signals import ends_by_signal

# Exit statuses; those of signals are 128 and their number.
NO_RESULT, WRONG_INPUT, FAULT_OF_SIGMAX = 1, 2, 70


def main() -> None:
    """Run the command line; what the user gave wrongly is one message and exit status 2."""
    with ends_by_signal():
        from sigmax.errors import InputError, without_app

        try:
            from sigmax.cli.app import app

            app()
        except InputError as error:
            print(f"sigmax: {error}", file=sys.stderr)
            raise SystemExit(WRONG_INPUT) from None
        except MemoryError as error:
            reason = f" ({error})" if str(error) else ""
            print(f"sigmax: there is not enough memory{reason}; split the data into parts", file=sys.stderr)
            raise SystemExit(WRONG_INPUT) from None
        except OSError as error:
            # What the system refuses is no fault of ours: a name that is too long, a disk that is gone.
            print(f"sigmax: {error}", file=sys.stderr)
            raise SystemExit(WRONG_INPUT) from None
        except Exception as error:
            if isinstance(error, ModuleNotFoundError) and (told := without_app("the command line", error)):
                print(f"sigmax: {told}", file=sys.stderr)
                raise SystemExit(WRONG_INPUT) from None
            import traceback

            traceback.print_exc()
            print(
                "sigmax: this is a fault of sigmax, not of yours; please report it with the lines above",
                file=sys.stderr,
            )
            raise SystemExit(FAULT_OF_SIGMAX) from None
