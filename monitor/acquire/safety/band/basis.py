"""What was learnt of one arm for its torque band, as a value and as a document for the process that streams the targets."""

from dataclasses import dataclass
from typing import Any

from monitor.acquire.safety.band.profile import TorqueProfile, profile_from_document
from monitor.judge.torque.compensated_model import CompensatedModel, model_from_document


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BandBasis:
    """What was learnt of an arm; nothing by default."""

    model: CompensatedModel | None = None  # of this arm with this load
    profile: TorqueProfile | None = None  # of the trajectory that is played, with this model
    payload_kg: float | None = None  # with which the model was learnt; None: not known

    @property
    def description(self) -> str:
        """What the band is made of, for a message."""
        if self.model is None:
            return "the manufacturer's parameters"
        learnt = "" if self.profile is None else f" and the profile of {self.profile.replays} earlier ones"
        return f"the model of {self.model.revision} replays{learnt}"

    def as_document(self) -> dict[str, Any]:
        """As JSON can carry it; `basis_from_document` is the inverse."""
        return {
            "model": None if self.model is None else self.model.as_document(),
            "payload_kg": self.payload_kg,
            "profile": None if self.profile is None else self.profile.as_document(),
        }


def basis_from_document(document: dict[str, Any]) -> BandBasis:
    """The basis from such a document. Raises BadInput where its model is none."""
    return BandBasis(
        model=None if document["model"] is None else model_from_document(document["model"]),
        payload_kg=document["payload_kg"],
        profile=None if document["profile"] is None else profile_from_document(document["profile"]),
    )
