"""Messages on bad input: one line, without control characters that a terminal would obey.

And warnings, as of the line of the program that has called the package.
"""

import sys
import warnings

_MOST_LETTERS = (400, 200)  # of what a file holds, at the beginning and at the end


class InputError(ValueError):
    """Bad input of the command line; the message is one line that says what is wrong and what to do."""


def printable(text: str) -> str:
    r"""The text with every character escaped that a terminal would not print, as ``repr`` does: ESC becomes ``\x1b``.

    Names of files and messages of parsers may contain sequences that move the cursor, change a title or break a line,
    and bytes that are not text. Letters of any alphabet stay as they are.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def reason_of(error: Exception) -> str:
    """What an exception says, in one line that a file cannot fill with its content; its type where it says nothing."""
    text = " ".join(str(error).split()) or type(error).__name__
    first, last = _MOST_LETTERS
    return text if len(text) <= first + last else f"{text[:first]} … {text[-last:]}"


def warn(message: str) -> None:
    """Warn, as of the line of the caller's program that has called the package."""
    frame, level = sys._getframe(1), 2
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] == "ccd_warp":
        frame, level = frame.f_back, level + 1
    warnings.warn(message, RuntimeWarning, stacklevel=level)
