"""What a page of one file is held to."""

from html.parser import HTMLParser

_VOID = ("meta", "br", "img", "input", "rect", "line", "circle")


class Balanced(HTMLParser):
    """Every tag that is opened is closed, in order; no address is outside of the page. `text` is
    what it says, `scripts` its scripts and data."""

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
