"""The tracker as a service: plots come as lines of JSON, tracks leave as lines of JSON."""

from sigmax.serving.checkpoint import Checkpoint
from sigmax.serving.feed import Feed
from sigmax.serving.server import serve
from sigmax.serving.service import Service

__all__ = ["Checkpoint", "Feed", "Service", "serve"]
