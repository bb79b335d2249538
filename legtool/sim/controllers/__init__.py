"""Whatever turns a command into torques: the built-in trot, learned policies, the user's own classes."""
