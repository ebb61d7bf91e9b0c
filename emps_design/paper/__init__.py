"""The paper of 2018: what it prints, the derivations, where they differ, and its section III on a virtual bench."""
