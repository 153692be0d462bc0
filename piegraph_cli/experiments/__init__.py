"""The paper's experiments: runs of several environments, and the tables and figures that they end in."""
