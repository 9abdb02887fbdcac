"""Checks of a single-file HTML page."""

from html.parser import HTMLParser

_VOID = ("meta", "br", "img", "input", "rect", "line", "circle")


class Balanced(HTMLParser):
    """Parser that checks a page: every opened tag is closed, in order, and no address is external.

    `text` is the page's text, `scripts` its scripts and data.
    """

    def __init__(self, page: str):
        super().__init__()
        self.open = []
        self.text = ""
        self.scripts = []
        self.feed(page)
        assert not self.open

    def handle_starttag(self, tag, attributes):
        assert not any(
            key in ("src", "href") and not value.startswith("data:") for key, value in attributes
        )
        if tag not in _VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes): ...

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open[-1:] == ["script"]:
            self.scripts.append(data)
        else:
            self.text += data
