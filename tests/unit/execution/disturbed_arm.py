"""The simulated arm with disturbances that its controller and its model do not know."""

import dataclasses

from deltasafe.execution import Workcell
from deltasafe.execution.simulated_arm import SimulatedArm


@dataclasses.dataclass(frozen=True)
class Push:
    """A force (3) in N, in the world frame, on a link (1 to 7, or 8 for the tool) at its center of mass."""

    force_n: tuple[float, float, float]
    start_s: float
    duration_s: float
    link: int = 7


class DisturbedArm(SimulatedArm):
    """Times count from the last reset; the payload is added to the last link."""

    def __init__(self, cell, seed, push=None, payload_kg=0.0):
        super().__init__(cell, seed)
        self._disturbance, self._steps = push, 0
        if payload_kg > 0:
            link_kg = self._bullet.getDynamicsInfo(self._arm, 6, physicsClientId=self._client)[0]
            self._bullet.changeDynamics(self._arm, 6, mass=link_kg + payload_kg, physicsClientId=self._client)

    def reset(self, joint_positions_rad):
        super().reset(joint_positions_rad)
        self._steps = 0

    def step(self, torques_nm):
        push, p, time_s = self._disturbance, self._bullet, self._steps * self.control_period_s
        if push is not None and push.start_s <= time_s < push.start_s + push.duration_s:
            link = push.link - 1
            center = p.getLinkState(self._arm, link, physicsClientId=self._client)[0]
            p.applyExternalForce(self._arm, link, push.force_n, center, p.WORLD_FRAME, physicsClientId=self._client)
        self._steps += 1
        return super().step(torques_nm)


def disturbed(body, mesh=None, push=None, payload_kg=0.0):
    cell = Workcell(body, mesh)
    return Workcell(body, mesh, make_arm=lambda seed: DisturbedArm(cell, seed, push, payload_kg))
