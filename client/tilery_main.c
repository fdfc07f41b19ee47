#include <string.h>

#include "client/cli.h"
#ifdef TILERY_HAS_IMPORT
#include "client/import.h"
#endif

int main(int argc, char **argv)
{
#ifdef TILERY_HAS_IMPORT
    if (argc > 1 && strcmp(argv[1], IMPORT_CHILD_ARGUMENT) == 0)
        return import_child_main(argc, argv);
#endif
    return cli_main(argc, argv);
}
