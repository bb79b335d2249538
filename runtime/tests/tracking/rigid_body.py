"""A single rigid body on its feet: integrates forces, full rotation, gyroscopic moments; nothing of the preview's."""

import numpy as np
from scipy.spatial.transform import Rotation

from legtool_runtime.tracking.preview import BodyState

G = np.array([0.0, 0.0, -9.81])


class RigidBody:
    def __init__(self, mass, inertia, state):
        self.mass, self.inertia = mass, np.asarray(inertia)
        self.position, self.velocity = np.array(state.position), np.array(state.velocity)
        self.rotation, self.spin = Rotation.from_matrix(state.rotation), np.array(state.angular_velocity)

    @property
    def state(self):
        return BodyState(self.position.copy(), self.velocity.copy(), self.rotation.as_matrix(), self.spin.copy())

    def step(self, forces, feet, dt, push=(0.0, 0.0, 0.0)):
        """Forces (4, 3) [N] at places (4, 3) [m] for a time."""
        turn = self.rotation.as_matrix()
        world = turn @ self.inertia @ turn.T
        moment = np.cross(feet - self.position, forces).sum(axis=0)
        acceleration = (forces.sum(axis=0) + push) / self.mass + G
        angular = np.linalg.solve(world, moment - np.cross(self.spin, world @ self.spin))
        self.position += dt * self.velocity + 0.5 * dt * dt * acceleration
        self.velocity += dt * acceleration
        self.spin += dt * angular
        self.rotation = Rotation.from_rotvec(dt * self.spin) * self.rotation
