# find_package(wsg) defines the target wsg::wsg, and on a computer wsg::host, which contains it. On Linux, wsg::host_shared is the shared
# library.
#
# On a computer the library is chosen by system and processor. For a board set WSG_TARGET, such as thumbv7em-none-eabihf, to one of
# the folders in lib.
if(NOT WSG_TARGET)
    string(TOLOWER "${CMAKE_SYSTEM_NAME}-${CMAKE_SYSTEM_PROCESSOR}" wsg_system)
    if(wsg_system STREQUAL "linux-x86_64")
        set(WSG_TARGET x86_64-unknown-linux-gnu)
    elseif(wsg_system STREQUAL "linux-aarch64")
        set(WSG_TARGET aarch64-unknown-linux-gnu)
    elseif(wsg_system STREQUAL "windows-amd64" OR wsg_system STREQUAL "windows-x86_64")
        set(WSG_TARGET x86_64-pc-windows-gnu)
    endif()
endif()

get_filename_component(wsg_root "${CMAKE_CURRENT_LIST_DIR}/../../.." ABSOLUTE)
set(wsg_library "${wsg_root}/lib/${WSG_TARGET}/libwsg.a")
if(NOT EXISTS "${wsg_library}")
    set(wsg_FOUND FALSE)
    set(wsg_NOT_FOUND_MESSAGE "no library for WSG_TARGET \"${WSG_TARGET}\" (${wsg_library})")
    return()
endif()
if(NOT TARGET wsg::wsg)
    add_library(wsg::wsg STATIC IMPORTED)
    set_target_properties(wsg::wsg PROPERTIES
        IMPORTED_LOCATION "${wsg_library}"
        INTERFACE_INCLUDE_DIRECTORIES "${wsg_root}/include")
endif()

set(wsg_host_library "${wsg_root}/lib/${WSG_TARGET}/libwsg_host.a")
if(EXISTS "${wsg_host_library}" AND NOT TARGET wsg::host)
    add_library(wsg::host STATIC IMPORTED)
    if(WIN32)
        set(wsg_host_system ws2_32 userenv ntdll)
    else()
        set(wsg_host_system pthread dl m)
    endif()
    set_target_properties(wsg::host PROPERTIES
        IMPORTED_LOCATION "${wsg_host_library}"
        INTERFACE_INCLUDE_DIRECTORIES "${wsg_root}/include"
        INTERFACE_LINK_LIBRARIES "${wsg_host_system}")
endif()

set(wsg_shared_library "${wsg_root}/lib/${WSG_TARGET}/shared/libwsg_host.so")
if(EXISTS "${wsg_shared_library}" AND NOT TARGET wsg::host_shared)
    add_library(wsg::host_shared SHARED IMPORTED)
    set_target_properties(wsg::host_shared PROPERTIES
        IMPORTED_LOCATION "${wsg_shared_library}"
        INTERFACE_INCLUDE_DIRECTORIES "${wsg_root}/include")
endif()
