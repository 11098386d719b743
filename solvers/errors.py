"""The errors a person can meet. Each message is one sentence: what, where, and the cure."""


class PhotogrammetryError(Exception):
    """Anything Collinea refuses; the command line prints it and exits with 1."""


class DegenerateGeometry(PhotogrammetryError):
    """The geometry cannot determine what was asked for (collinear, coplanar, too few, behind the camera)."""


class BadTable(PhotogrammetryError):
    """A table could not be read; names the file, the line, the item and the cure."""


class BadProject(PhotogrammetryError):
    """A project folder is incomplete or contradicts itself."""


class Unsupported(PhotogrammetryError):
    """Correct input that Collinea cannot process."""
