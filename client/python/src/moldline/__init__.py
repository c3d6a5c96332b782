"""Client of a Moldline server, which deforms surface meshes with their geometry.

    client = moldline.Client("127.0.0.1:50051")
    setup = client.create_setup("examples/e175", progress=True)
    with setup.session() as session:
        result = session.deform({"wing.translation": 5.0})
        gradient = session.vjp(functions={"enclosed_volume": 1.0}, at=result).design

Vertices are float64 arrays of shape (n, 3) in metres; designs are float64 arrays of shape (number of variables,),
each entry in its variable's unit.
"""

from moldline.check import Check, CheckedDesign, CheckedVariable, Difference, DotProduct
from moldline.client import (
    Client,
    Deformation,
    DesignPoint,
    Function,
    Gradients,
    Jacobian,
    Linearisation,
    Progress,
    Session,
    Setup,
    Tangents,
    Variable,
    VariableGroup,
)
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
    "Check",
    "CheckedDesign",
    "CheckedVariable",
    "Client",
    "DeadlineExceeded",
    "Deformation",
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
    "Linearisation",
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
    "Tangents",
    "Unavailable",
    "Variable",
    "VariableGroup",
    "write_vtu",
]
