from .diagnosis import diagnose as diagnose
from .request import DiagnosisRequest as DiagnosisRequest
from .result import Diagnosis as Diagnosis, Finding as Finding
