"""The rules of association by name, as descriptions give them."""

from sigmax.tracking.associate import Associate, gnn, jpda, nearest, pda
from sigmax.tracking.branches import MultiHypothesis, mht

ASSOCIATIONS: dict[str, Associate | MultiHypothesis] = {
    "gnn": gnn,
    "jpda": jpda,
    "mht": mht(),
    "nearest": nearest,
    "pda": pda,
}
