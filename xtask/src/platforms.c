/* Random numbers for Rust's standard library: the bcryptprimitives.dll of Windows, which Debian's Wine 8 lacks. */
#include <windows.h>
#include <ntsecapi.h>

__declspec(dllexport) BOOL WINAPI ProcessPrng(BYTE *data, SIZE_T len)
{
    return RtlGenRandom(data, (ULONG)len);
}
