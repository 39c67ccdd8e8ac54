"""What is said of bad input: one line, and nothing in it that a terminal obeys."""


class InputError(ValueError):
    """Bad input of the command line; the message is one line that says what is wrong and what to do."""


def printable(text: str) -> str:
    r"""The text with every character escaped that a terminal would not print, as ``repr`` does: ESC becomes ``\x1b``.

    Names of files and messages of parsers may hold what moves the cursor, changes a title or breaks a line, and bytes
    that are no text. Letters of any alphabet stay as they are.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)
