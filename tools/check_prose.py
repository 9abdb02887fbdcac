"""Measure the prose of the package and of the documentation against limits.

    python tools/check_prose.py              # one row per measure; exit code 1 above a limit
    python tools/check_prose.py --worst 20   # and the sentences to rewrite first

The limits are the achieved values (CONTRIBUTING, "Style"). Lower them when the text improves.
"""

from __future__ import annotations

import argparse
import ast
import inspect
import io
import re
import tokenize
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

LIMITS = {
    "docstrings that start with a clause, %": 0.2,
    "function docstrings that do not start with an imperative verb, %": 0.0,
    "docstring sentence, mean words": 11.2,
    "'what' per 10 000 words of code text": 1.0,
    "words to avoid per 10 000 words of code text": 1.2,
    "identifiers that end in _most or _least, or contain what": 0.0,
    "documentation sentence, mean words": 12.4,
    "documentation sentences above 40 words, %": 0.2,
    "documentation paragraphs above 100 words, %": 0.2,
    "documentation, longest paragraph, words": 90.0,
    "words to avoid per 10 000 words of tests": 1.2,
    "words to avoid per 10 000 words of documentation": 5.7,
    "words to avoid per 10 000 words of decision records": 0.5,
    "documentation, words (code and equations left out)": 42100.0,
}
WORD = re.compile(r"[A-Za-z][A-Za-z'-]*")
CLAUSE = re.compile(r"[`\"'(*]*(What|Whether|Of|How|Where|By|Who|Which|When|As|m|N|s|Pa)\b")
AVOID = re.compile(
    r"\b(felt|feels?|told|tells?|said|says?|foretold|foretell|doubt(s|ed)?|believe[sd]?|beside|anew"
    r"|begun|somebody|nobody|whoever|things?|knock(ed|s)?|wish(ed)?|happenings?|troubles|pane"
    r"|what is|of which|as far as|at all|for good|no more than|let go|gives? up|given up"
    r"|goes on|went on|pictures?|made up|sensing chain|honest|hurry|for ever)\b",
    re.IGNORECASE,
)
"""Words and phrases with a standard replacement in the table of CONTRIBUTING."""
EXTREME = re.compile(r"(_|^)(most|least)$|(_|^)what(_|$)")
VERBS = frozenset(Path(__file__).with_name("docstring_verbs.txt").read_text("utf-8").split())
"""First words of function docstrings. Add a verb if none of these fits."""
_HEADING = re.compile(r"\s*(Args|Returns|Raises|Attributes|Yields|Notes?|Examples?)\s*:?\s*$")
_LIST_ITEM = re.compile(r"\s*([-*+]|\d+\.) ")
_NOT_PROSE = re.compile(r"\s*(#|\||[-=]{3,}\s*$)")


@dataclass
class Text:
    """Sentences and comments found, each with the place it comes from."""

    first: list[tuple[str, str]] = field(default_factory=list)
    """The first sentence of each docstring."""
    functions: list[tuple[str, str]] = field(default_factory=list)
    """The docstring of each function that is not a property."""
    sentences: list[tuple[str, str]] = field(default_factory=list)
    comments: list[str] = field(default_factory=list)
    paragraphs: list[str] = field(default_factory=list)
    extreme_names: set[str] = field(default_factory=set)
    """Identifiers that end in _most or _least, or contain the word what."""
    size: int = 0
    """Words of all pages, tables and headings included."""


def words(text: str) -> int:
    """Count words."""
    return len(WORD.findall(text))


def split_sentences(text: str) -> list[str]:
    """Split plain text into sentences of three words or more."""
    parts: list[str] = []
    for paragraph in re.split(r"\n\s*\n", text):
        # an entry of a list ("name: ...", "- ...") begins a sentence
        for entry in re.split(r"\n\s*(?=[-*] |[\w`*, ]{1,40}: )", paragraph):
            flat = " ".join(entry.split())
            parts += re.split(r"(?<=[.!?])[`\"')*]*\s+(?=[A-Z`\"(*])", flat)
    return [part for part in parts if words(part) >= 3]


def read_code(folder: Path) -> Text:
    """Collect docstrings, comments and identifiers of every Python file in a folder."""
    text = Text()
    for path in sorted(folder.rglob("*.py")):
        source = path.read_text(encoding="utf-8")
        tree = ast.parse(source)
        text.functions += [(f"{path}:{line}", each) for line, each in _functions(tree)]
        for line, docstring in _docstrings(tree):
            found = [(f"{path}:{line}", each) for each in split_sentences(_prose(docstring))]
            text.sentences += found
            text.first += found[:1]
        for token in tokenize.generate_tokens(io.StringIO(source).readline):
            if token.type == tokenize.COMMENT:
                text.comments.append(token.string.lstrip("# "))
            elif token.type == tokenize.NAME and EXTREME.search(token.string):
                text.extreme_names.add(token.string)
    return text


def _docstrings(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield line and text of every string that stands alone: docstrings, also of attributes."""
    for node in ast.walk(tree):
        for item in body if isinstance(body := getattr(node, "body", None), list) else []:
            value = item.value if isinstance(item, ast.Expr) else None
            if isinstance(value, ast.Constant) and isinstance(value.value, str):
                yield item.lineno, inspect.cleandoc(value.value)


def _functions(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield line and docstring of every function that is not a property."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            decorators = " ".join(map(ast.unparse, node.decorator_list))
            if (docstring := ast.get_docstring(node)) and "property" not in decorators:
                yield node.body[0].lineno, docstring


def is_imperative(docstring: str) -> bool:
    """Return True if a docstring starts with one of `VERBS`."""
    return docstring.split(maxsplit=1)[0].rstrip(",.:;") in VERBS


def _prose(docstring: str) -> str:
    """Remove code and section headings."""
    lines = re.sub(r"```.*?```", "\n\n", docstring, flags=re.DOTALL).split("\n")
    return "\n".join("" if _HEADING.match(line) or ">>>" in line else line for line in lines)


def read_pages(paths: Sequence[Path]) -> Text:
    """Collect paragraphs and sentences of Markdown pages, without code, tables and headings."""
    text = Text()
    for path in paths:
        page = re.sub(r"```.*?```|\$\$.*?\$\$", "\n\n", path.read_text("utf-8"), flags=re.DOTALL)
        page = re.sub(r"<!--.*?-->", "", page, flags=re.DOTALL)
        page = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", page)
        found = [each for block in re.split(r"\n\s*\n", page) for each in _paragraphs(block)]
        text.size += sum(words(line) for line in page.split("\n") if not line.startswith("    "))
        text.paragraphs += found
        text.sentences += [(str(path), part) for each in found for part in split_sentences(each)]
    return text


def _paragraphs(block: str) -> Iterator[str]:
    """Yield the paragraphs and list items between two blank lines."""
    if all(line.startswith("    ") for line in block.split("\n") if line.strip()):
        return  # an indented block of code
    lines: list[str] = []
    for line in [*block.split("\n"), "#"]:
        if _LIST_ITEM.match(line) or _NOT_PROSE.match(line):
            if words(" ".join(lines)) >= 3:
                yield " ".join(lines)
            lines = [line.strip()] if _LIST_ITEM.match(line) else []
        else:
            lines.append(line.strip())


def measure(code: Text, tests: Text, pages: Text, records: Text) -> dict[str, float]:
    """Return the value of each measure in `LIMITS`."""
    prose = _prose_of(code)
    documents = "\n".join(pages.paragraphs)
    long = [words(each) for _, each in pages.sentences]
    sizes = [words(each) for each in pages.paragraphs]
    clauses = [bool(CLAUSE.match(each)) for _, each in code.first]
    values = (
        100 * _mean(clauses),
        100 * _mean([not is_imperative(each) for _, each in code.functions]),
        _mean([words(each) for _, each in code.sentences]),
        _rate(re.compile(r"\bwhat\b", re.IGNORECASE), prose),
        _rate(AVOID, prose),
        len(code.extreme_names),
        _mean(long),
        100 * _mean([size > 40 for size in long]),
        100 * _mean([size > 100 for size in sizes]),
        max(sizes, default=0),
        _rate(AVOID, _prose_of(tests)),
        _rate(AVOID, documents),
        _rate(AVOID, "\n".join(records.paragraphs)),
        pages.size,
    )
    return dict(zip(LIMITS, map(float, values), strict=True))


def _prose_of(code: Text) -> str:
    """Join docstrings and comments."""
    return "\n".join([*(each for _, each in code.sentences), *code.comments])


def _mean(values: Sequence[float]) -> float:
    return sum(values) / max(len(values), 1)


def _rate(pattern: re.Pattern[str], text: str) -> float:
    """Return occurrences per 10 000 words."""
    return 1e4 * len(pattern.findall(text)) / max(words(text), 1)


def worst(code: Text, pages: Text, count: int) -> list[tuple[str, str]]:
    """Return the sentences with most words to avoid, wrong first words and excess length."""
    no_verb = {place for place, docstring in code.functions if not is_imperative(docstring)}
    starts = {row for row in code.first if row[0] in no_verb}

    def score(row: tuple[str, str]) -> float:
        sentence = row[1]
        excess = max(words(sentence) - 25, 0) / 10
        start = bool(CLAUSE.match(sentence)) or row in starts
        return len(AVOID.findall(sentence)) + excess + 2 * start

    return sorted([*code.sentences, *pages.sentences], key=score, reverse=True)[:count]


def main() -> int:
    """Print the measures and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else None)
    parser.add_argument("--worst", type=int, default=0, metavar="N", help="print N sentences")
    options = parser.parse_args()
    root = Path(__file__).parents[1]
    records = sorted((root / "docs" / "decisions").rglob("*.md"))
    pages = sorted(set((root / "docs").rglob("*.md")) - set(records))
    documents = read_pages([root / "README.md", root / "CONTRIBUTING.md", *pages])
    code = read_code(root / "mjtactile")
    for folder in ("benchmarks", "controllers", "tools"):
        code.functions += read_code(root / folder).functions
    tests = read_code(root / "tests")
    code.extreme_names |= tests.extreme_names
    values = measure(code, tests, documents, read_pages(records))
    above = [name for name, value in values.items() if value > LIMITS[name] + 0.05]
    if above or options.worst:
        for name, value in values.items():
            mark = "  above its limit" if name in above else ""
            print(f"{name:64} {value:8.1f}   at most {LIMITS[name]:g}{mark}")
    for place, sentence in worst(code, documents, options.worst):
        print(f"\n{place}\n    {sentence}")
    return 1 if above else 0


if __name__ == "__main__":
    raise SystemExit(main())
