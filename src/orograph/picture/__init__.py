"""Pictures: what is drawn (``Scene``), from where (``camera``), and the CPU backend that draws it (``cpu``)."""

from orograph.light.sun import Sun
from orograph.picture import camera
from orograph.picture.api import render
from orograph.picture.contours import Contours
from orograph.picture.result import Picture
from orograph.picture.scene import Scene
from orograph.picture.silhouettes import Silhouettes

__all__ = ["Contours", "Picture", "Scene", "Silhouettes", "Sun", "camera", "render"]
