from .feedforward import FeedForward as FeedForward
from .study import Compensation as Compensation, compensate as compensate
