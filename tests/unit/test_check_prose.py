"""Tests of the counts of the prose check."""

from pathlib import Path

from tools import check_prose


def test_words_to_avoid_raise_the_measures(tmp_path):
    bad = tmp_path / "bad"
    bad.mkdir()
    (bad / "a.py").write_text(
        '"""What is felt, as far as somebody told it."""\nfall_most = what_fell = 1\n'
    )
    good = tmp_path / "good"
    good.mkdir()
    (good / "a.py").write_text('"""Return the estimated force, N."""\nfall_max = 1\n')
    page = tmp_path / "page.md"
    code = "\n    mjtactile grasp\n\n$$\nF = p A\n$$\n"
    text = "# Title\n\nThe force is estimated. It has a unit.\n\n| a | b |\n"
    page.write_text(text + code)
    pages = check_prose.read_pages([page])
    record = tmp_path / "record.md"
    record.write_text("What is felt is told.\n")
    private = check_prose.read_pages([record])
    assert pages.paragraphs == ["The force is estimated. It has a unit."]
    values = check_prose.measure(*2 * [check_prose.read_code(bad)], pages, private)
    assert values["docstrings that start with a clause, %"] == 100
    assert values["identifiers that end in _most or _least, or contain what"] == 2
    assert values["'what' per 10 000 words of code text"] > 1000
    assert values["words to avoid per 10 000 words of code text"] > 3000
    assert values["words to avoid per 10 000 words of tests"] > 3000
    assert values["words to avoid per 10 000 words of decision records"] > 3000
    clean = check_prose.measure(*2 * [check_prose.read_code(good)], pages, pages)
    counts = ("sentence", "paragraph", "documentation, words")
    assert all(
        value == 0 for name, value in clean.items() if not any(part in name for part in counts)
    )
    assert clean["documentation, longest paragraph, words"] == 8
    assert clean["documentation sentence, mean words"] == 4
    # the title and the table count, too
    assert clean["documentation, words (code and equations left out)"] == 11


def test_functions_that_start_with_a_noun_are_counted(tmp_path):
    code = """
def noun():
    \"\"\"The force, N.\"\"\"

class Sensor:
    \"\"\"Sensor of a finger.\"\"\"

    @property
    def pressure(self):
        \"\"\"Pressure, Pa.\"\"\"

    async def read(self):
        \"\"\"Read, or wait.\"\"\"

    @classmethod
    def of(cls):
        \"\"\"As `read`.\"\"\"

    def plain(self):
        return 1

def write():
    \"\"\"Write the force, N.\"\"\"
"""
    (tmp_path / "a.py").write_text(code)
    nothing = check_prose.Text()
    text = check_prose.read_code(tmp_path)
    values = check_prose.measure(text, nothing, nothing, nothing)
    # `noun` and `of` of the four functions with a docstring; the property and the class are nouns
    assert values["function docstrings that do not start with an imperative verb, %"] == 50
    first = [sentence for _, sentence in check_prose.worst(text, nothing, 1)]
    assert first == ["The force, N."]


def test_the_list_of_verbs_has_no_duplicate_and_no_noun():
    words = (Path(check_prose.__file__).with_name("docstring_verbs.txt")).read_text().split()
    assert words == sorted(set(words))
    # such a first word would hide "Force, N." or "Height of the membrane, m."
    quantities = {"Force", "Height", "Position", "Rate", "Number", "State", "Time", "Weight"}
    assert not quantities & set(words)
