"""The control plane: what crosses between the manager and its components, and how it travels.

Each component listens on its own address; the manager connects to it, and so does its peer of a hand-over.
:mod:`.commands` has the typed commands, each with its reply; :mod:`.state` what a component reports; :mod:`.frames` the
envelope and its codec. :mod:`.transport` defines what a transport is: :mod:`.sockets` is that of real systems (Unix
sockets, in the folders of :mod:`.folders`), :mod:`.pipe` an in-memory one. :mod:`.channel` and :mod:`.command_server`
are the two ends of a connection. Nothing here uses ROS.
"""

PUBLIC = (
    "Accepted ClockAnswer ClockOffset ComponentHello ForwardedConnection HOST_PROTOCOL OtherHostAddress SAME_CLOCK "
    "Word clock_offset introduce short_name "
    "AnswerCommand AwaitIdleCommand AwaitMatchCommand AwaitRateCommand AwaitWriteCommand COMPONENTS Channel "
    "Claimed ClockMoment Command CommandHandler CommandServer ComponentReport ComponentState Connection "
    "CountWritesCommand CutClaimCommand CutLock CutClock CutInCommand CutOutCommand CutOutcome CutResult CutSwap "
    "CutTakenCommand DiscoverCommand ENV_BACKEND ENV_CONTROL ENV_DIAGNOSTICS ENV_INSTANCE ENV_NAMESPACE ENV_NODE "
    "ENV_PARAMETERS ENV_PATIENCE ENV_SET_PARAMETERS ENV_SHARED_NAME ENV_STANDBY ENV_START ENV_SYSTEM ENV_TOKEN "
    "Endpoint FenceCommand FieldSamples FileFingerprint FunctionalityState GateCommand GateState GoalCounts "
    "Greeting Grid GridCommand ImportStateCommand JoinRequestsCommand KeepLeaseCommand LEASE_SLACK LastWrite "
    "LinkState MEMORY Measured MeasuredResponses MovedState MuteCommand NOT_WELCOMED ObserveCommand PROTOCOL "
    "PagePlace PipeLock PipeEnd PipeNetwork PrepareStateCommand Program ProgramCommand RATE_TOLERANCE RateVerdict "
    "Receipt RecordCommand Records RecordsCommand Registration ReleaseCommand Reply Request ResolveCutsCommand Serve "
    "SetParametersCommand ShareSlotCommand SharedSlotPlace SharedSlotPort SocketFolder StateTransfer "
    "StopListening THIS_HOST Transport TriggerKind UndeclaredTopic WITH_PLACE WelcomeCommand WireValue commands "
    "duration_in_words environment files_named frames open_socket replies result_of workspace_folder "
    "workspace_root Frame INVALID LONGEST_FRAME OLDEST SPOKEN"
)
