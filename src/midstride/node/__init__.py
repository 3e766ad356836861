"""The inside of a component's process: the author's API, mode switching, and the agent that obeys the manager."""

PUBLIC = (
    "CalledService ClockHistory DiagnosticEntry GoalAnswers GoalTurn HOLD HeldParameter Host MessageInfo "
    "NodeParameters PassableRequest ProcessContext ProgramFiles RequestAdmission find installed legible loaded_program "
    "process_context"
)
