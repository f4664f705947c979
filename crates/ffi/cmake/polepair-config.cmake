# find_package(polepair) gives the target polepair::polepair: the shared library, or the static one without it.
get_filename_component(_polepair_prefix "${CMAKE_CURRENT_LIST_DIR}/../../.." ABSOLUTE)

find_path(POLEPAIR_INCLUDE_DIR polepair.h HINTS "${_polepair_prefix}/include" NO_DEFAULT_PATH)
find_library(POLEPAIR_LIBRARY polepair
    HINTS "${_polepair_prefix}/lib" "${_polepair_prefix}/lib/${CMAKE_LIBRARY_ARCHITECTURE}"
    NO_DEFAULT_PATH)
mark_as_advanced(POLEPAIR_INCLUDE_DIR POLEPAIR_LIBRARY)

include(FindPackageHandleStandardArgs)
find_package_handle_standard_args(polepair REQUIRED_VARS POLEPAIR_LIBRARY POLEPAIR_INCLUDE_DIR)

if(polepair_FOUND AND NOT TARGET polepair::polepair)
    add_library(polepair::polepair UNKNOWN IMPORTED)
    set_target_properties(polepair::polepair PROPERTIES
        IMPORTED_LOCATION "${POLEPAIR_LIBRARY}"
        INTERFACE_INCLUDE_DIRECTORIES "${POLEPAIR_INCLUDE_DIR}")
    if(POLEPAIR_LIBRARY MATCHES "\\.a$")
        find_package(Threads REQUIRED)
        target_link_libraries(polepair::polepair INTERFACE Threads::Threads m ${CMAKE_DL_LIBS})
    endif()
endif()
