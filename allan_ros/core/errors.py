# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The error class of the package, and text that is safe to print."""

from typing import Any

SHOWN_START, SHOWN_END = 1500, 500
"""Numbers of characters that are kept at the start and at the end of a text that is too long."""


def one_line(text: str) -> str:
    """Return the text as one line of limited length that is safe to print.

    The text may contain names from files and messages that are not trusted. A character that is
    not printable is replaced by its escape sequence, such as ``\\x1b``. The middle of a text of
    more than ``SHOWN_START + SHOWN_END`` characters is replaced by ``...``.
    """
    if not text.isprintable():
        text = ''.join(c if c.isprintable() else repr(c)[1:-1] for c in text)
    if len(text) > SHOWN_START + SHOWN_END:
        return f'{text[:SHOWN_START]} ... {text[-SHOWN_END:]}'
    return text


class AllanError(Exception):
    """An error that a user can fix; public functions raise it for unusable input.

    The message is one line with the cause, the numbers and the next step. The command line and
    the nodes print it without a traceback.

    Attributes
    ----------
    findings : tuple
        Findings that explain the error. Public functions and the command line add their texts to
        the message; a public function then leaves this tuple empty.

    Examples
    --------
    >>> import allan_ros as ar
    >>> try:
    ...     ar.analyze('missing.mcap')
    ... except ar.AllanError as error:
    ...     print(error)
    missing.mcap: no such file or folder: check the path
    """

    def __init__(self, message: str, findings: tuple[Any, ...] = ()) -> None:
        super().__init__(one_line(message))
        self.findings = findings

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (str(self), self.findings)
