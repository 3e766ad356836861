"""The records of a manager: the journal, the saved state, events, and their JSON forms."""

PUBLIC = (
    "ChangeLock ChangeRecord ChangeReport ChangeTimeline ClosingConnection CrashedInstance DISK Database "
    "DeadHost DegradedFunctionality Disk DownReport EndpointStatus Event EventCounts EventLog FencedInstance "
    "FieldStatus FunctionalityStatus GAP_BOUNDS GoalTally History HostStatus Incident InstanceStatus Interrupted "
    "Journal JournalEntry KilledProcess LeftState LiveConfiguration Middleware ModeInterval ModeRecorder ModeSkew "
    "NewChange Observation OtherEndpoints OtherNodeStatus Outcome OutcomeKind ParameterStatus ParametersReport Phase "
    "PlannedChange PortStatus ProgramStatus Rehearsal RehearsalOrder RehearsedSeed RequirementStatus RespawnStatus "
    "RunningCommand SAME_MODE SavedInstance SavedState Service SilenceFault SilenceKind SpareStatus "
    "SpecificationVersion StateMove StateStore Statement Status StepTime SwapReport TopicStatus UnixTime UpReport "
    "WINDOW_PERIODS Wakers Why closed_history closed_report in_order killed_processes mode_level report reports "
    "require_readable status_forms unknown_report"
)
