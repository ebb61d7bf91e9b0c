from .export import Exported as Exported, export_controller as export_controller, export_observer as export_observer
