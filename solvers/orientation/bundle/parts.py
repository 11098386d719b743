"""Parts of a block that share no point."""

from __future__ import annotations

import numpy as np


def parts(image: np.ndarray, point: np.ndarray) -> list[np.ndarray]:
    """The images of each connected part, the largest first, from observations: images (o,) and points (o,) they are of."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import connected_components

    if not len(image):
        return []
    m = int(image.max()) + 1
    n = m + int(point.max()) + 1
    label = connected_components(csr_matrix((np.ones(len(image), np.int8), (image, m + point)), shape=(n, n)), directed=False)[1]
    seen = np.unique(image)
    found = [seen[label[seen] == k] for k in np.unique(label[seen])]
    return sorted(found, key=lambda part: -len(part))


def told(names: list[str], most: int = 6) -> str:
    """The first names, quoted."""
    return ", ".join(f"'{n}'" for n in names[:most]) + (" ..." if len(names) > most else "")
