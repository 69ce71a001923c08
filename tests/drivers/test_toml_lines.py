"""The lines of keys in TOML texts."""

from __future__ import annotations

import tomllib

import pytest

from drivers.toml_lines import line_of, line_of_syntax_error, lines_of_keys

_TEXT = '''\
# comment
top = 1
note = """
[fake]
key = 2
"""

[table]
inline = { a = 1, "b c" = [1, 2] }
long = [
  1,  # first
  2,
]
[[row]]
x = 1
[[row]]
deep.er = 2
[row.sub]
y = 3
'''


@pytest.mark.parametrize(
    ("path", "line"),
    [
        (("top",), 2),
        (("note",), 3),
        (("table",), 8),
        (("table", "inline", "b c", 1), 9),
        (("table", "long"), 10),
        (("row", 0, "x"), 15),
        (("row", 1), 16),
        (("row", 1, "deep", "er"), 17),
        (("row", 1, "sub", "y"), 19),
    ],
)
def test_each_key_is_found_on_the_line_that_writes_it(
    path: tuple[str | int, ...], line: int
) -> None:
    assert lines_of_keys(_TEXT)[path] == line


def test_what_looks_like_a_key_inside_a_string_is_none() -> None:
    assert ("fake",) not in lines_of_keys(_TEXT)


def test_a_key_that_is_not_written_has_the_line_of_its_table() -> None:
    lines = lines_of_keys(_TEXT)
    assert line_of(("row", 1, "sub", "missing"), lines) == 18
    assert line_of(("nowhere", "at all"), lines) == 1


@pytest.mark.parametrize(
    ("text", "line"), [("a = 1\nb = \nc = 3\n", 2), ("a = 1\n\n[table\n", 3), ('a = """\nb\n', 2)]
)
def test_a_syntax_error_names_its_line(text: str, line: int) -> None:
    with pytest.raises(tomllib.TOMLDecodeError) as caught:
        tomllib.loads(text)
    assert line_of_syntax_error(caught.value, text) == line
