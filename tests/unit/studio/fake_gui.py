"""Stand-in for Dear ImGui and ImPlot: stores all texts, and applies user actions by label."""

from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np


class FakeGui:
    """Stand-in GUI. `texts` are the texts and labels of the last build. `set_input` sets the
    input of a widget in the next build."""

    def __init__(self, real):
        self._real = real
        self.texts = []
        self._inputs = {}

    def __getattr__(self, name):
        real = getattr(self._real, name)
        return real if isinstance(real, type) else self._nothing  # flags and the like are real

    def set_input(self, label, value=True):
        self._inputs[label.split("###")[0]] = value

    def _take(self, label):
        self.texts.append(label)
        return self._inputs.pop(label.split("###")[0], None)

    @staticmethod
    def _nothing(*_, **__):
        return None

    def Begin(self, *_):
        return True, True

    def BeginTabBar(self, *_):
        return True

    BeginTabItem = BeginTabBar

    def CollapsingHeader(self, label, *_):
        return True

    TreeNode = CollapsingHeader

    def Button(self, label, *_):
        return bool(self._take(label))

    def Checkbox(self, label, value):
        requested = self._take(label)
        return (False, value) if requested is None else (True, requested)

    def SliderFloat(self, label, value, *_):
        requested = self._take(label)
        return (False, value) if requested is None else (True, requested)

    InputInt = SliderFloat

    def Combo(self, label, value, items):
        requested = self._take(label)
        return (False, value) if requested is None else (True, items.index(requested))

    def TextUnformatted(self, text):
        self.texts.append(text)

    TextWrapped = TextDisabled = TextUnformatted

    def TextColored(self, _, text):
        self.texts.append(text)

    def IsItemHovered(self, *_):
        return False

    def GetWindowDrawList(self):
        return MagicMock()

    def GetIO(self):
        return SimpleNamespace(DisplaySize=SimpleNamespace(x=1280, y=800))

    def Vec2(self, x, y):
        return SimpleNamespace(x=x, y=y)

    def Vec4(self, *rgba):
        return rgba


class FakePlot(FakeGui):
    """`geoms` are the curves: label to times and values."""

    def __init__(self, real):
        super().__init__(real)
        self.geoms = {}

    def BeginPlot(self, *_):
        return True

    def PlotLine(self, label, time, values):
        self.geoms[label] = np.array(time), np.array(values)

    def PlotErrorBars(self, label, time, values, errors):
        self.geoms[f"{label}, bars"] = np.array(values), np.array(errors)

    def GetPlotPos(self):
        return SimpleNamespace(x=0.0, y=0.0)

    def GetPlotSize(self):
        return SimpleNamespace(x=500.0, y=200.0)

    def PlotToPixels(self, x, y):
        return SimpleNamespace(x=x, y=y)


class FakeViewer:
    """Viewer interface as used by a plug-in; `images` are the uploaded textures."""

    def __init__(self):
        self.extra_geoms = []
        self.images = {}
        self.data = SimpleNamespace(xpos=np.zeros((0, 3)))

    def upload_image(self, texture, pixels, width, height, channels):
        texture = texture or len(self.images) + 1
        self.images[texture] = np.frombuffer(pixels, np.uint8).reshape(height, width, channels)
        return texture
