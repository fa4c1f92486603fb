"""From plots to tracks: initiation, gating, association, track life, for many targets at once."""

from sigmax.tracking.associate import gnn, jpda, nearest, pda
from sigmax.tracking.branches import mht
from sigmax.tracking.cycle import Cycle
from sigmax.tracking.detector import Detector, Located, Scan, crowded, in_shadow, polar, positions, reports
from sigmax.tracking.health import SensorHealth, health
from sigmax.tracking.hypotheses import hypotheses
from sigmax.tracking.initiate import Layout, single_plot, two_point
from sigmax.tracking.life import by_existence, m_of_n
from sigmax.tracking.metrics import Quality, Truth, gospa, ospa, quality
from sigmax.tracking.modes import Modes
from sigmax.tracking.state import Told
from sigmax.tracking.tracker import Tracker, in_order

__all__ = [
    "Cycle",
    "Detector",
    "Layout",
    "Located",
    "Modes",
    "Quality",
    "Scan",
    "SensorHealth",
    "Told",
    "Tracker",
    "Truth",
    "by_existence",
    "crowded",
    "gnn",
    "gospa",
    "health",
    "hypotheses",
    "in_order",
    "in_shadow",
    "jpda",
    "m_of_n",
    "mht",
    "nearest",
    "ospa",
    "pda",
    "polar",
    "positions",
    "quality",
    "reports",
    "single_plot",
    "two_point",
]
