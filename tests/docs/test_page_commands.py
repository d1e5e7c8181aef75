"""Blocks of a page as tests read them, on pages made up here."""

import pytest
from page_commands import Block, blocks, commands, planned, run, ways_of

PAGE = """# A page

<!-- test: multicell run: --set duration="1 h" -->
<!-- test: 12 -> 3 -->
```sh
python3 -m venv .venv && .venv/bin/pip install . && .venv/bin/multicell run growth -o out  # all
multicell run spheroid -o "a # b" \\
    --seed 12   # goes on
multicell scenes
```

- In a list

  % test: file mine.py
  ```python
  x = 1
  ```

````md
```sh
not a block of its own
```
````
"""


def test_blocks_are_found_with_what_is_said_of_them():
    found = list(blocks(PAGE))
    places = [(block.line, block.language) for block in found]
    assert places == [(5, "sh"), (15, "python"), (19, "md")]
    assert found[1].text == "x = 1"
    assert ways_of(found[1]).name == "mine.py"
    assert "not a block" in found[2].text


def test_commands_are_joined_split_and_shortened():
    first = next(blocks(PAGE))
    last = ['multicell run spheroid -o "a # b" --seed 12', "multicell scenes"]
    assert commands(first.text)[3:] == last
    lines = planned(first)
    assert [bool(reason) for _, reason in lines] == [True, True, False, False, False]
    assert lines[2][0] == '.venv/bin/multicell run growth -o out --set duration="1 h"'
    assert lines[3][0] == 'multicell run spheroid -o "a # b" --seed 3 --set duration="1 h"'
    # it has no such option
    assert lines[4][0] == "multicell scenes"


def test_what_is_said_in_vain_is_told():
    with pytest.raises(ValueError, match="has no '8 d'"):
        planned(Block(1, "sh", "multicell scenes", ["8 d -> 1 d"]))
    with pytest.raises(ValueError, match="no block follows"):
        list(blocks("% test: no, it takes long\n\nText"))


@pytest.mark.parametrize("command", ["multicell run", "multicell nosuch | head", "exit 3"])
def test_commands_that_fail_are_told(command, tmp_path):
    with pytest.raises(AssertionError, match="ended with"):
        run(f"set -o pipefail; {command}" if "|" in command else command, tmp_path)
