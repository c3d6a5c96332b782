"""Client of Moldline: the mesh service, which deforms surface meshes with their geometry.

    client = moldline.Client("127.0.0.1:50051")
    setup = client.create_setup("examples/e175", progress=True)
    with setup.session() as session:
        result = session.deform({"wing.translation": 5.0})
        gradient = session.vjp(functions={"enclosed_volume": 1.0}, at=result).design

Vertices are float64 arrays of shape (n, 3) in metres; designs are float64 arrays of shape (number of variables,),
each entry in its variable's unit. :mod:`moldline.aio` is the same for asyncio, :mod:`moldline.panel` the client of the panel
service.
"""

import logging
from importlib.metadata import version as _version

from moldline import panel
from moldline.check import Check, CheckedDesign, CheckedVariable, Difference, DotProduct, Kink
from moldline.client import Client, Session, Setup, serve
from moldline.connection import TLS
from moldline.designs import Design
from moldline.errors import (
    Aborted,
    AlreadyExists,
    Cancelled,
    DeadlineExceeded,
    FailedPrecondition,
    FieldViolation,
    InternalError,
    InvalidArgument,
    MoldlineError,
    NotFound,
    OutOfRange,
    PermissionDenied,
    ResourceExhausted,
    Unauthenticated,
    Unavailable,
)
from moldline.mesh import Mesh, write_cells, write_vtu
from moldline.model import (
    At,
    CacheStatus,
    Deformation,
    DesignPoint,
    Function,
    Gradients,
    Jacobian,
    Linearisation,
    Progress,
    SessionState,
    SetupAccess,
    SetupSummary,
    Status,
    Tangents,
    Variable,
    VariableGroup,
    Visibility,
    Work,
)
from moldline.quality import Distribution, QualityReport, QualitySummary
from moldline.retry import Retry

__version__ = _version("moldline")

# Silent until the program that uses this chooses otherwise.
logging.getLogger("moldline").addHandler(logging.NullHandler())

__all__ = [
    "TLS",
    "Aborted",
    "AlreadyExists",
    "At",
    "CacheStatus",
    "Cancelled",
    "Check",
    "CheckedDesign",
    "CheckedVariable",
    "Client",
    "DeadlineExceeded",
    "Deformation",
    "Design",
    "DesignPoint",
    "Difference",
    "Distribution",
    "DotProduct",
    "FailedPrecondition",
    "FieldViolation",
    "Function",
    "Gradients",
    "InternalError",
    "InvalidArgument",
    "Jacobian",
    "Kink",
    "Linearisation",
    "Mesh",
    "MoldlineError",
    "NotFound",
    "OutOfRange",
    "PermissionDenied",
    "Progress",
    "QualityReport",
    "QualitySummary",
    "ResourceExhausted",
    "Retry",
    "Session",
    "SessionState",
    "Setup",
    "SetupAccess",
    "SetupSummary",
    "Status",
    "Tangents",
    "Unauthenticated",
    "Unavailable",
    "Variable",
    "VariableGroup",
    "Visibility",
    "Work",
    "panel",
    "serve",
    "write_cells",
    "write_vtu",
]
