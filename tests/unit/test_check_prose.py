"""Tests of the counts of the prose check."""

from tools import check_prose


def test_a_private_sentence_raises_the_measures(tmp_path):
    bad = tmp_path / "bad"
    bad.mkdir()
    (bad / "a.py").write_text('"""What is felt, as far as somebody told it."""\nfall_most = 1\n')
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
    values = check_prose.measure(check_prose.read_code(bad), pages, private)
    assert values["docstrings that start with a clause, %"] == 100
    assert values["identifiers that end in _most or _least"] == 1
    assert values["'what' per 10 000 words of code text"] > 1000
    assert values["words to avoid per 10 000 words of code text"] > 3000
    assert values["words to avoid per 10 000 words of decision records"] > 3000
    clean = check_prose.measure(check_prose.read_code(good), pages, pages)
    counts = ("sentence", "paragraph", "documentation, words")
    assert all(
        value == 0 for name, value in clean.items() if not any(part in name for part in counts)
    )
    assert clean["documentation, longest paragraph, words"] == 8
    assert clean["documentation sentence, mean words"] == 4
    # the title and the table count, too
    assert clean["documentation, words (code and equations left out)"] == 11
