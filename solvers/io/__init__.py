"""Everything that is read from and written to a disk: project folders, tables, photos, traces."""

from .project import read_project, read_truth, write_observations, write_project

__all__ = ["read_project", "read_truth", "write_observations", "write_project"]
