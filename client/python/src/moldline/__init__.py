"""Client of a Moldline server, which deforms surface meshes with their geometry.

    client = moldline.Client("127.0.0.1:50051")
    setup = client.create_setup("examples/e175", progress=True)
    with setup.session() as session:
        result = session.deform({"wing.translation": 5.0})

Vertices are float64 arrays of shape (n, 3) in metres; designs are float64 arrays of shape (number of variables,),
each entry in its variable's unit.
"""

from moldline.client import Client, Deformation, Progress, Session, Setup, Variable, VariableGroup
from moldline.errors import (
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
    ResourceExhausted,
    Unavailable,
)
from moldline.mesh import Mesh, write_vtu
from moldline.quality import Distribution, QualityReport, QualitySummary

__all__ = [
    "AlreadyExists",
    "Cancelled",
    "Client",
    "DeadlineExceeded",
    "Deformation",
    "Distribution",
    "FailedPrecondition",
    "FieldViolation",
    "InternalError",
    "InvalidArgument",
    "Mesh",
    "MoldlineError",
    "NotFound",
    "OutOfRange",
    "Progress",
    "QualityReport",
    "QualitySummary",
    "ResourceExhausted",
    "Session",
    "Setup",
    "Unavailable",
    "Variable",
    "VariableGroup",
    "write_vtu",
]
