"""The API of node authors: components, ports, functionalities and their modes."""

PUBLIC = (
    "ABSENT ActionClientPort ActionServerPort Callbacks ClientLink ClientPort Component DeclaredMode DeclaredParts "
    "Driven FieldChecks Function Functionality GatePolicy Guarantee Input InputLink Listener MessageTimes OVERDUE "
    "Output OutputLink OutputOwner Parameter ServerLink ServerPort any_of approximate at_least at_most between "
    "component_class fitted_to guarantee type_name window_of WriteLease"
)
